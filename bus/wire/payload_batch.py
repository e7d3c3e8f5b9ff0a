"""Payloads of many units at once: a few array operations in place of a call a payload."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, chain, pairwise
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.wire.fixed_layout import FixedLayoutCodec

Places = NDArray[np.intp]


@final
class PayloadBatch:
    """The payloads of all units in one tick, one behind the other, where all their fields are binary.

    Args:
        forms: Layout of each unit's payload; all with the same fields.

    Attributes:
        sizes: Bytes of each unit's payload.
        tick_at: Place of the tick, the same in all payloads.
    """

    def __init__(self, forms: Sequence[FixedLayoutCodec]) -> None:
        blanks = [form.blank() for form in forms]
        spans = [form.spans() for form in forms]
        self.sizes: list[int] = [len(blank) for blank in blanks]
        self.tick_at = spans[0][0]
        begins: list[int] = [0, *accumulate(self.sizes)]
        self._cuts = [slice(*ends) for ends in pairwise(begins)]
        self._all = np.frombuffer(bytearray(b"".join(blanks)), np.uint8)
        where = [
            _places(
                [range(begin + at.start, begin + at.stop) for begin, at in zip(begins, ats, strict=False)]
            )
            for ats in zip(*spans, strict=True)
        ]
        self._tick_at: Places = where[0]
        self.fields: Sequence[Places] = where[1:]
        """Places of each field's bytes in the joined payloads, unit by unit."""
        fixed = np.ones(len(self._all), dtype=np.bool_)
        fixed[np.concatenate(where)] = False
        self._marks_at: Places = np.flatnonzero(fixed)
        self._marks = self._all[self._marks_at].tobytes()

    @staticmethod
    def stamp(tick: int) -> bytes:
        """Return the bytes of a payload at ``tick_at``."""
        return tick.to_bytes(8, "big")

    def write(self, tick: int, columns: Sequence[bytes]) -> list[bytes]:
        """Return a payload a unit.

        Args:
            tick: The tick.
            columns: For each field, its bytes of all units, in their order.
        """
        joined = self._all
        joined[self._tick_at] = np.frombuffer(self.stamp(tick) * len(self.sizes), np.uint8)
        for at, column in zip(self.fields, columns, strict=True):
            if len(at):
                joined[at] = np.frombuffer(column, np.uint8)
        payloads = joined.tobytes()
        return [payloads[cut] for cut in self._cuts]

    def join(self, payloads: Sequence[bytes]) -> NDArray[np.uint8] | None:
        """Join a payload a unit, of the right sizes; None where one is in another layout. The tick is not looked at."""
        joined = np.frombuffer(b"".join(payloads), np.uint8)
        return joined if joined.take(self._marks_at).tobytes() == self._marks else None


def _places(ranges: Sequence[range]) -> Places:
    """Return the numbers of all ranges, one behind the other."""
    return np.array(list(chain.from_iterable(ranges)), dtype=np.intp)
