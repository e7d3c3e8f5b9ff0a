"""Sampling of sensors within one call of the plant, each cell at its own instant."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant.errors import PlantError
from plant.observations import Sense

Floats = NDArray[np.float64]


class Timing(NamedTuple):
    """Instants of the cells between ``now`` and ``until``, both in ns of simulated time.

    Attributes:
        acts_ns: ``(n,)`` in ``[now, until)``: when a cell's drive of this call takes effect; before, its last one goes
            on. -1: it acts from the start.
        reads_ns: ``(n,)`` in ``[now, until]``: when a cell reads sensors and encoders. -1: it doesn't in this call.
    """

    acts_ns: NDArray[np.int64]
    reads_ns: NDArray[np.int64]

    def check(self, cells: int, now_ns: int, until_ns: int) -> None:
        """Refuse instants outside the call.

        Args:
            cells: number of cells in the array.
            now_ns: start of the call, ns.
            until_ns: end of the call, ns.

        Raises:
            PlantError: an instant is outside the call, or the number of instants isn't the number of cells.
        """
        spans = (("acts_ns", now_ns, until_ns - 1), ("reads_ns", now_ns, until_ns))
        for (name, first, last), given in zip(spans, self, strict=True):
            if given.shape != (cells,):
                raise PlantError(f"{name} has shape {given.shape}: the array has {cells} cells")
            if given.min() >= first and given.max() <= last:
                continue  # nearly always, and every tick
            wrong = ((given < first) & (given != -1)) | (given > last)
            if wrong.any():
                cell = int(np.flatnonzero(wrong)[0])
                raise PlantError(f"{name}[{cell}] = {given[cell]}: must be -1 or in {first}..{last}")

    def acts_s(self, now_ns: int) -> Floats:
        """``(n,)`` s after ``now_ns`` when drives take effect; 0 at the start."""
        return np.maximum(self.acts_ns - now_ns, 0) * 1e-9

    def reads_s(self, now_ns: int, until_ns: int) -> Floats:
        """``(n,)`` s after ``now_ns`` when cells read; infinite for those that don't between the call's ends."""
        inside = (self.reads_ns > now_ns) & (self.reads_ns < until_ns)
        return np.where(inside, (self.reads_ns - now_ns) * 1e-9, np.inf)


@final
class SensorSampler:
    """Collects sensor readings; a cell without a reading in this call keeps its last.

    Args:
        last: last readings of all cells, not changed.
        timing: reading instants of the cells.
        now_ns: start of the call, ns.
        until_ns: end of the call, ns.

    Attributes:
        instants_s: reading times after the call's start, ``(n,)``, s; infinite for cells that don't read within the
            call.
        any_at_start: whether some cells read at the start.
        any_inside: whether some cells read between start and end.
    """

    def __init__(self, last: Sense, timing: Timing, now_ns: int, until_ns: int) -> None:
        self.instants_s: Floats = timing.reads_s(now_ns, until_ns)
        self._at_end = timing.reads_ns == until_ns
        self._at_start = timing.reads_ns == now_ns
        inside = self.instants_s < np.inf
        self.any_inside = bool(inside.any())
        self.any_at_start = bool(self._at_start.any())
        self._inside = inside
        # who reads sees a parcel only where one is near: those cells are set below
        self._presence: NDArray[np.bool_] = last.presence & ~inside[:, None]
        self._level = None if last.level is None else np.where(inside[:, None], 0.0, last.level)
        self._label = None if last.label is None else np.where(inside, 0, last.label)
        self._encoder_m = None if last.encoder_m is None else last.encoder_m.copy()
        self._slowed_m: Floats | None = None

    @property
    def requested_s(self) -> Floats | None:
        """``(n,)`` ``instants_s``, the start for those that don't read on the way; None where none does."""
        return np.where(self._inside, self.instants_s, 0.0) if self.any_inside else None

    def sample_at(self, now_s: float, sense: Sense, slowed_m: Floats | None) -> None:
        """Sample the sensors of the cells whose reading instant is ``now_s``.

        Args:
            now_s: s after the call's start.
            sense: what all would read now; its encoders are not read.
            slowed_m: ``(n, 2)`` what loads have taken from the wheels' way since the start; None: nothing.
        """
        now = self.instants_s == now_s
        self._see(now, sense)
        if slowed_m is not None:
            if self._slowed_m is None:
                self._slowed_m = np.zeros_like(slowed_m)
            self._slowed_m[now] = slowed_m[now]

    def set_presence(self, presence: NDArray[np.bool_]) -> None:
        """Take what sensors ``(n, sensors)`` see, each cell's at its instant."""
        self._presence[self._inside] = presence[self._inside]

    def set_encoders(self, encoder_m: Floats | None) -> None:
        """Store encoder values ``(n, 2)`` of reading cells, each at its instant, corrected for slowing by loads."""
        if self._encoder_m is not None and encoder_m is not None:
            if self._slowed_m is not None:
                encoder_m = encoder_m + self._slowed_m
            self._encoder_m[self._inside] = encoder_m[self._inside]

    def start(self, sense: Sense) -> None:
        """Sample the sensors of the cells that read at the start of the call; ``sense``: readings of all cells then."""
        self._take(self._at_start, sense)

    def sense(self, end: Sense) -> Sense:
        """Return each cell's reading; ``end`` is the reading of all cells at the end of the call."""
        self._take(self._at_end, end)
        if self._encoder_m is not None:
            self._encoder_m.setflags(write=False)
        return Sense(self._presence, self._encoder_m, self._level, self._label)

    def _take(self, cells: NDArray[np.bool_], sense: Sense) -> None:
        self._see(cells, sense)
        if self._encoder_m is not None and sense.encoder_m is not None:
            self._encoder_m[cells] = sense.encoder_m[cells]

    def _see(self, cells: NDArray[np.bool_], sense: Sense) -> None:
        self._presence[cells] = sense.presence[cells]
        if self._level is not None and sense.level is not None:
            self._level[cells] = sense.level[cells]
        if self._label is not None and sense.label is not None:
            self._label[cells] = sense.label[cells]
