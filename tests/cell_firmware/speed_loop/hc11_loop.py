"""The integer speed loop as a program of the MC68HC11: both wheels unrolled, all variables in page 0.

The interrupt reads two 8-bit counts, does what ``FixedPointLoop.act`` and ``whole_levels`` do, and leaves integrals and
duties. Gains, shifts and limits are constants of the program.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cell_firmware.speed_loop.scaling import Gain, Scaling
from cell_firmware.speed_loop.sensing import FRACTION_BITS
from tests.cell_firmware.speed_loop.hc11 import Program

WHEELS = "01"
SIZES = {"reference": 2, "count": 1, "last": 1, "integral": 4, "duty": 2}
"""Variables of a wheel, bytes; big-endian."""
_SCRATCH = {
    "error": 2,
    "size": 2,
    "product": 4,
    "grown": 4,
    "wanted": 4,
    "output": 4,
    "way": 4,
    "long": 6,
    "sign": 1,
}


class LoopProgram(Program):
    """The program of a scaling.

    Args:
        scaling: Of a loop with an 8-bit encoder and no feed-forward.
    """

    def __init__(self, scaling: Scaling) -> None:
        super().__init__()
        assert scaling.feed_forward.word == 0
        for wheel in WHEELS:
            for name, size in SIZES.items():
                self.room(name + wheel, size)
        for name, size in _SCRATCH.items():
            self.room(name, size)
        for wheel in WHEELS:
            self._wheel(wheel, scaling)
        self("rti")

    def _wheel(self, wheel: str, scaling: Scaling) -> None:
        integral = f"integral{wheel}"
        self._error(wheel, scaling.error_limit)
        self._gain(scaling.ki)
        self._add("grown", integral, "product")
        self._gain(scaling.kp)
        self._add("wanted", "grown", "product")
        self._move("output", "wanted")
        self._clamp("output", scaling.output_limit)
        saturated, done = self.label(), self.label()
        for half in ("", "+2"):
            self("ldd", f"output{half}")
            self("subd", f"wanted{half}")
            self("bne", saturated)
        self._clamp("grown", scaling.output_limit)
        self._move(integral, "grown")
        self("jmp", done)
        self.place(saturated)
        self._conditioned(integral, scaling.share)
        self.place(done)
        self._duty(wheel)

    def _error(self, wheel: str, limit: int) -> None:
        """The limited error in Q4 and its magnitude."""
        self("ldab", f"count{wheel}")
        self("ldaa", f"count{wheel}")
        self("subb", f"last{wheel}")
        self("staa", f"last{wheel}")
        self("clra")
        self("tstb")
        self._unless("bpl", lambda: self("coma"))
        for _ in range(FRACTION_BITS):
            self("lsld")
        self("std", "size")
        self("ldd", f"reference{wheel}")
        self("subd", "size")
        for bound, within in ((limit, "ble"), (-limit, "bge")):
            self("cpd", f"#{bound}")
            self._unless(within, lambda bound=bound: self("ldd", f"#{bound}"))
        self("std", "error")
        self("tsta")
        self._unless("bpl", self._negate_d)
        self("std", "size")

    def _gain(self, gain: Gain) -> None:
        """The error's product with a gain, to the nearest: of magnitudes, byte by byte."""
        high, low = gain.word >> 8, gain.word & 255
        for byte, constant, place in (("size+1", low, "product+2"), ("size", high, "product")):
            self._times(byte, constant)
            self("std", place)
        for byte, constant in (("size+1", high), ("size", low)):
            self._times(byte, constant)
            self("addd", "product+1")
            self("std", "product+1")
            self._unless("bcc", lambda: self("inc", "product"))
        self("ldaa", "error")
        self._unless("bpl", lambda: self._negate("product"))
        if gain.shift <= 0:
            for _ in range(-gain.shift):
                self._double("product")
            return
        self("ldd", "product+2")
        self("addd", f"#{(1 << (gain.shift - 1)) & 0xFFFF}")
        self("std", "product+2")
        self._unless("bcc", self._carry_product)
        self._halve("product", gain.shift)

    def _carry_product(self) -> None:
        self("ldd", "product")
        self("addd", "#1")
        self("std", "product")

    def _conditioned(self, integral: str, share: Gain) -> None:
        """The integral's way to the output by its share: 24 by 15 bits, away from zero."""
        assert 16 <= share.shift < 32
        high, low = share.word >> 8, share.word & 255
        self._subtract("way", "output", integral)
        self._magnitude("way")
        self._times("way+3", low)
        self("std", "long+4")
        self._times("way+2", high)
        self("std", "long+2")
        self("clra")
        self("clrb")
        self("std", "long")
        self._times("way+1", high)
        self("addd", "long+1")
        self("std", "long+1")
        for byte, constant, place, carries in (
            ("way+3", high, "long+3", ("long+2", "long+1", "long")),
            ("way+2", low, "long+3", ("long+2", "long+1", "long")),
            ("way+1", low, "long+2", ("long+1", "long")),
        ):
            self._times(byte, constant)
            self("addd", place)
            self("std", place)
            self._ripple(carries)
        up = (1 << share.shift) - 1
        self("ldd", "long+4")
        self("addd", f"#{up & 0xFFFF}")
        self("std", "long+4")
        self("ldd", "long+2")
        self("adcb", f"#{(up >> 16) & 255}")
        self("adca", f"#{(up >> 24) & 255}")
        self("std", "long+2")
        self("ldd", "long")
        self("adcb", "#0")
        self("adca", "#0")
        self("std", "long")
        self._halve("long", share.shift - 16)
        self._move("way", "long")
        self._signed(lambda: self._negate("way"))
        self._add(integral, integral, "way")

    def _ripple(self, bytes_up: tuple[str, ...]) -> None:
        end = self.label()
        self("bcc", end)
        for number, byte in enumerate(bytes_up):
            self("inc", byte)
            if number < len(bytes_up) - 1:
                self("bne", end)
        self.place(end)

    def _duty(self, wheel: str) -> None:
        """Whole levels of the output: its magnitude to the nearest."""
        self._magnitude("output")
        self("ldd", "output+2")
        self("addd", "#2048")
        self("std", "output+2")
        self("ldaa", "output+1")
        self("adca", "#0")
        self("ldab", "output+2")
        for _ in range(4):
            self("lsrd")
        self._signed(self._negate_d)
        self("std", f"duty{wheel}")

    def _clamp(self, name: str, limit: int) -> None:
        below, high, low, end = (self.label() for _ in range(4))
        under = -limit & 0xFFFFFFFF
        self("ldd", name)
        self("bmi", below)
        self("cpd", f"#{limit >> 16}")
        self("blo", end)
        self("bhi", high)
        self("ldd", f"{name}+2")
        self("cpd", f"#{limit & 0xFFFF}")
        self("bls", end)
        self.place(high)
        self._constant(name, limit)
        self("bra", end)
        self.place(below)
        self("cpd", f"#{under >> 16}")
        self("bgt", end)
        self("blt", low)
        self("ldd", f"{name}+2")
        self("cpd", f"#{under & 0xFFFF}")
        self("bhs", end)
        self.place(low)
        self._constant(name, under)
        self.place(end)

    def _constant(self, name: str, value: int) -> None:
        self("ldd", f"#{value >> 16}")
        self("std", name)
        self("ldd", f"#{value & 0xFFFF}")
        self("std", f"{name}+2")

    def _unless(self, branch: str, body: Callable[[], None]) -> None:
        end = self.label()
        self(branch, end)
        body()
        self.place(end)

    def _signed(self, negate: Callable[[], None]) -> None:
        self("tst", "sign")
        self._unless("beq", negate)

    def _magnitude(self, name: str) -> None:
        self("clr", "sign")
        self("ldaa", name)

        def flip() -> None:
            self("inc", "sign")
            self._negate(name)

        self._unless("bpl", flip)

    def _negate_d(self) -> None:
        self("coma")
        self("comb")
        self("addd", "#1")

    def _times(self, byte: str, constant: int) -> None:
        self("ldaa", byte)
        self("ldab", f"#{constant}")
        self("mul")

    def _combine(self, to: str, one: str, other: str, low: str, high: str) -> None:
        self("ldd", f"{one}+2")
        self(f"{low}", f"{other}+2")
        self("std", f"{to}+2")
        self("ldd", one)
        self(f"{high}b", f"{other}+1")
        self(f"{high}a", other)
        self("std", to)

    def _add(self, to: str, one: str, other: str) -> None:
        self._combine(to, one, other, "addd", "adc")

    def _subtract(self, to: str, one: str, other: str) -> None:
        self._combine(to, one, other, "subd", "sbc")

    def _negate(self, name: str) -> None:
        self("ldd", "#0")
        self("subd", f"{name}+2")
        self("std", f"{name}+2")
        self("ldd", "#0")
        self("sbcb", f"{name}+1")
        self("sbca", name)
        self("std", name)

    def _move(self, to: str, name: str) -> None:
        for half in ("", "+2"):
            self("ldd", f"{name}{half}")
            self("std", f"{to}{half}")

    def _double(self, name: str) -> None:
        self("ldd", f"{name}+2")
        self("lsld")
        self("std", f"{name}+2")
        self("ldd", name)
        self("rolb")
        self("rola")
        self("std", name)

    def _halve(self, name: str, times: int) -> None:
        """An arithmetic shift to the right, whole bytes first."""
        while times >= 8:
            self("ldaa", f"{name}+2")
            self("staa", f"{name}+3")
            self("ldd", name)
            self("std", f"{name}+1")
            self("clrb")
            self("tsta")
            self._unless("bpl", lambda: self("decb"))
            self("stab", name)
            times -= 8
        for _ in range(times):
            self("ldd", name)
            self("asra")
            self("rorb")
            self("std", name)
            self("ldd", f"{name}+2")
            self("rora")
            self("rorb")
            self("std", f"{name}+2")

    def put(self, memory: NDArray[np.int64], name: str, value: NDArray[np.int64]) -> None:
        """Write a variable of both wheels, ``(m, 2)``, into m page zeros ``(m, 256)``."""
        size = SIZES[name]
        for number, wheel in enumerate(WHEELS):
            for byte in range(size):
                memory[:, self.names[name + wheel] + byte] = (value[:, number] >> 8 * (size - 1 - byte)) & 255

    def get(self, memory: NDArray[np.int64], name: str) -> NDArray[np.int64]:
        """Read a signed variable of both wheels, ``(m, 2)``."""
        size = SIZES[name]
        found = np.zeros((len(memory), 2), dtype=np.int64)
        for number, wheel in enumerate(WHEELS):
            for byte in range(size):
                found[:, number] = (found[:, number] << 8) | memory[:, self.names[name + wheel] + byte]
        half = 1 << (8 * size - 1)
        return (found ^ half) - half
