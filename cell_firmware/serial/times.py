"""How long what happens on a line takes, by the clocks at its two ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cell_firmware.firmware import Bools, State
from cell_firmware.serial.rates import BITS_A_BYTE
from cell_firmware.serial.sampling import sample_map
from cell_firmware.serial.settings import Ints, LineSettings, by_clock

_IDLE_BITS: Final = 9
"""Ones after a byte that make an idle character with its stop bit."""


@final
@dataclass(frozen=True, slots=True)
class LineTimes:
    """Times from a byte's start, ns; ``(n, 4)`` where cells have clocks of their own.

    Attributes:
        late_ns: How much later everything comes than it does on the line.
        byte_ns: To the next byte's start, by the sender's clock.
        come_ns: Until the byte is there: its stop bit is sampled, and what is late has come.
        idle_ns: Until an idle character has passed after it: ten ones, of which its stop bit is the first.
        stop_ns: Until the receiver samples its stop bit, by its own clock.
        samples: ``(n, 4, 10)`` of ``sample_map``; None where clocks are equal.
        skewed: Where samples miss their bits.
    """

    late_ns: int
    byte_ns: Ints | int
    come_ns: Ints | int
    idle_ns: Ints | int
    stop_ns: Ints | int
    samples: Ints | None = None
    skewed: Bools | None = None

    @staticmethod
    def of(
        settings: LineSettings, late_ns: int, own: Ints | None = None, sender: Ints | None = None
    ) -> LineTimes:
        """Those of lines whose receivers' clocks, ``(n, 1)``, and senders', ``(n, 4)``, are off by so many ppb."""
        bit = settings.bit_ns
        byte_ns = by_clock(settings.byte_ns, sender)
        come_ns = by_clock(19 * bit // 2, sender) + late_ns
        idle_ns = byte_ns + by_clock(_IDLE_BITS * bit, own)
        stop_ns = by_clock(19 * bit // 2, own)
        if own is None or sender is None:
            return LineTimes(late_ns, byte_ns, come_ns, idle_ns, stop_ns)
        samples = sample_map(own, sender)
        skewed = (samples != np.arange(BITS_A_BYTE)).any(axis=2)
        return LineTimes(late_ns, byte_ns, come_ns, idle_ns, stop_ns, samples, skewed)

    def state(self) -> State:
        """Those that differ from line to line, as a part's state carries them."""
        lines = np.shape(self.byte_ns)
        return {name: np.broadcast_to(getattr(self, name), _shape(name, lines)).copy() for name in _VARYING}

    @staticmethod
    def from_state(late_ns: int, state: State) -> LineTimes:
        """What ``state`` made of them."""
        return LineTimes(late_ns, *(state[name] for name in _VARYING))


_VARYING: Final = ("byte_ns", "come_ns", "idle_ns", "stop_ns", "samples", "skewed")


def _shape(name: str, lines: tuple[int, ...]) -> tuple[int, ...]:
    return (*lines, BITS_A_BYTE) if name == "samples" else lines
