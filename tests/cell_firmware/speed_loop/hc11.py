"""MC68HC11 instructions as the speed loop's program needs them: an assembler, and an interpreter that counts cycles.

Operands are immediate (``"#5"``), in page 0 (``"name"`` or ``"name+1"``; extended where an instruction has no direct
mode) or labels. Cycles are those of the M68HC11 reference manual. Nothing is encoded: a program is a table of numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

# cycles: immediate, direct, extended, inherent or branch; 0 where there is no such mode
_CYCLES: Final[Mapping[str, tuple[int, int, int, int]]] = {
    **dict.fromkeys(("ldaa", "ldab", "adca", "adcb", "sbca", "sbcb", "subb"), (2, 3, 4, 0)),
    **dict.fromkeys(("staa", "stab"), (0, 3, 4, 0)),
    "ldd": (3, 4, 5, 0),
    "std": (0, 4, 5, 0),
    **dict.fromkeys(("addd", "subd"), (4, 5, 6, 0)),
    "cpd": (5, 6, 7, 0),
    **dict.fromkeys(("inc", "clr", "tst"), (0, 0, 6, 0)),
    **dict.fromkeys(
        ("clra", "clrb", "coma", "comb", "tsta", "tstb", "asra", "rora", "rorb", "rola", "rolb", "decb"),
        (0, 0, 0, 2),
    ),
    **dict.fromkeys(("lsld", "lsrd"), (0, 0, 0, 3)),
    "mul": (0, 0, 0, 10),
    **dict.fromkeys(
        (
            "bpl",
            "bmi",
            "bcc",
            "bne",
            "beq",
            "bhi",
            "blo",
            "bls",
            "bhs",
            "bgt",
            "blt",
            "bge",
            "ble",
            "bra",
            "jmp",
        ),
        (0, 0, 0, 3),
    ),
    "rti": (0, 0, 0, 12),
}
ENTRY_E: Final = 14
"""Cycles from an interrupt to its first instruction."""
_CODES: Final = {name: code for code, name in enumerate(_CYCLES)}
_BRANCHES: Final = [name for name in _CODES if name[0] == "b" or name == "jmp"]


class Program:
    """Instructions in the order in which they are added."""

    def __init__(self) -> None:
        self.names: dict[str, int] = {}
        self._size = 0
        self._lines: list[tuple[str, str]] = []
        self._labels: dict[str, int] = {}
        self._given = 0

    def room(self, name: str, size: int) -> None:
        """Give a variable its place in page 0."""
        self.names[name] = self._size
        self._size += size

    def __call__(self, name: str, operand: str = "") -> None:
        self._lines.append((name, operand))

    def label(self) -> str:
        """A label to be placed."""
        self._given += 1
        return f".{self._given}"

    def place(self, label: str) -> None:
        """The label is here."""
        self._labels[label] = len(self._lines)

    @property
    def table(self) -> NDArray[np.int64]:
        """``(instructions, 4)``: code, whether immediate, operand, cycles."""
        return np.array([self._encoded(name, operand) for name, operand in self._lines], dtype=np.int64)

    def _encoded(self, name: str, operand: str) -> tuple[int, int, int, int]:
        immediate, direct, extended, inherent = _CYCLES[name]
        if name in _BRANCHES:
            return _CODES[name], 0, self._labels[operand], inherent
        if not operand:
            return _CODES[name], 0, 0, inherent
        if operand.startswith("#"):
            return _CODES[name], 1, int(operand[1:]), immediate
        variable, _, offset = operand.partition("+")
        return _CODES[name], 0, self.names[variable] + int(offset or 0), direct or extended


_C: Final = _CODES
(
    LDAA, LDAB, ADCA, ADCB, SBCA, SBCB, SUBB, STAA, STAB, LDD, STD, ADDD, SUBD, CPD, INC, CLR, TST, CLRA, CLRB, COMA,
    COMB, TSTA, TSTB, ASRA, RORA, RORB, ROLA, ROLB, DECB, LSLD, LSRD, MUL, BPL, BMI, BCC, BNE, BEQ, BHI, BLO, BLS, BHS,
    BGT, BLT, BGE, BLE, BRA, JMP, RTI,
) = _C.values()  # fmt: skip


def run(table: NDArray[np.int64], memory: NDArray[Any]) -> int:  # noqa: C901, PLR0915 - an instruction set
    """Run to the first ``rti``: cycles of an interrupt, its entry included. ``memory`` is page 0, 256 bytes.

    Plain enough for numba to compile.
    """
    a = b = n = z = v = c = at = 0
    spent = ENTRY_E
    while True:
        code, immediate, operand, cycles = table[at, 0], table[at, 1], table[at, 2], table[at, 3]
        spent += cycles
        at += 1
        if code == RTI:
            return spent
        if code >= BPL:
            take = (
                code in (BRA, JMP)
                or (code == BPL and not n)
                or (code == BMI and n)
                or (code == BCC and not c)
                or (code == BNE and not z)
                or (code == BEQ and z)
                or (code == BHI and not (c or z))
                or (code == BLO and c)
                or (code == BLS and (c or z))
                or (code == BHS and not c)
                or (code == BGT and not (z or n != v))
                or (code == BLT and n != v)
                or (code == BGE and n == v)
                or (code == BLE and (z or n != v))
            )
            if take:
                at = operand
            continue
        if code in (LDD, ADDD, SUBD, CPD, STD, LSLD, LSRD, MUL):
            d = (a << 8) | b
            if code == STD:
                memory[operand], memory[operand + 1] = a, b
                n, z, v = d >> 15, int(d == 0), 0
                continue
            if code == MUL:
                d = a * b
                a, b, c = d >> 8, d & 255, (d >> 7) & 1
                continue
            if code == LSLD:
                c, d = d >> 15, (d << 1) & 0xFFFF
                a, b, n, z = d >> 8, d & 255, d >> 15, int(d == 0)
                v = n ^ c
                continue
            if code == LSRD:
                c, d = d & 1, d >> 1
                a, b, n, z, v = d >> 8, d & 255, 0, int(d == 0), c
                continue
            word = operand & 0xFFFF if immediate else (memory[operand] << 8) | memory[operand + 1]
            if code == LDD:
                d, v = word, 0
            elif code == ADDD:
                total = d + word
                v = int((~(d ^ word) & (d ^ total) & 0x8000) != 0)
                c, d = total >> 16, total & 0xFFFF
            else:
                total = d - word
                v = int(((d ^ word) & (d ^ total) & 0x8000) != 0)
                c, d = int(total < 0), total & 0xFFFF
            n, z = d >> 15, int(d == 0)
            if code != CPD:
                a, b = d >> 8, d & 255
            continue
        if code in (STAA, STAB):
            byte = a if code == STAA else b
            memory[operand] = byte
            n, z, v = byte >> 7, int(byte == 0), 0
            continue
        if code in (INC, CLR, TST):
            byte = memory[operand]
            if code == INC:
                v = int(byte == 127)
                byte = (byte + 1) & 255
            else:
                byte, v, c = (0 if code == CLR else byte), 0, 0
            memory[operand] = byte
            n, z = byte >> 7, int(byte == 0)
            continue
        of_b = code in (LDAB, ADCB, SBCB, SUBB, CLRB, COMB, TSTB, RORB, ROLB, DECB)
        old = b if of_b else a
        byte = operand & 255 if immediate else memory[operand & 255]
        if code in (LDAA, LDAB):
            new, v = byte, 0
        elif code in (ADCA, ADCB):
            total = old + byte + c
            new = total & 255
            v, c = int((~(old ^ byte) & (old ^ new) & 128) != 0), total >> 8
        elif code in (SBCA, SBCB, SUBB):
            total = old - byte - (0 if code == SUBB else c)
            new = total & 255
            v, c = int(((old ^ byte) & (old ^ new) & 128) != 0), int(total < 0)
        elif code in (CLRA, CLRB):
            new, v, c = 0, 0, 0
        elif code in (COMA, COMB):
            new, v, c = 255 - old, 0, 1
        elif code in (TSTA, TSTB):
            new, v, c = old, 0, 0
        elif code == DECB:
            new, v = (old - 1) & 255, int(old == 128)
        elif code == ASRA:
            new, c = (old >> 1) | (old & 128), old & 1
            v = (new >> 7) ^ c
        elif code in (RORA, RORB):
            new, c = (old >> 1) | (c << 7), old & 1
            v = (new >> 7) ^ c
        else:
            new, c = ((old << 1) & 255) | c, old >> 7
            v = (new >> 7) ^ c
        n, z = new >> 7, int(new == 0)
        if of_b:
            b = new
        else:
            a = new
