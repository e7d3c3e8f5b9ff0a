"""Interface of the page to a run: instants, registers, events and requests, of a recording or a run in progress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from deploy.faults.fault_state import FaultState
    from deploy.recordings.format import Header

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@final
@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """State of a run at one instant.

    Attributes:
        tick: The tick that begins at the instant.
        time_s: Simulated time, s.
        parcels: ``(m, 6)`` states of the parcels; NaN while a parcel is absent.
        wheel_speeds: ``(n, 2)`` surface speeds of the wheels, m/s.
        presence: ``(n, sensors)`` readings of the presence sensors.
        health: ``(n,)`` uint8: alive, faulty or dead.
    """

    tick: int
    time_s: float
    parcels: Floats
    wheel_speeds: NDArray[Any]
    presence: NDArray[np.bool_]
    health: NDArray[np.uint8]


@final
@dataclass(frozen=True, slots=True)
class RunState:
    """State of the run behind a source.

    Attributes:
        state: ``recorded``, ``running``, ``paused`` or ``ended``.
        speed: Pace, simulated seconds a wall second; None: as fast as possible, or a recording.
        real_time_factor: Measured pace; None: unknown.
        lag_s: Lag behind the pace, wall seconds; None: unknown.
    """

    state: str
    speed: float | None = None
    real_time_factor: float | None = None
    lag_s: float | None = None


class RunSource(Protocol):
    """A run as the page sees it; instants are numbered from 0, oldest first.

    Attributes:
        header: Header of the run's recording.
        live: Whether more instants come.
        revision: Increased when instants that were there have changed or left, as after a reset.
        events: Events of the plant, as recordings have them.
        faults: Faults, as recordings have them.
        fault_state: The same faults over time, for each cell.
    """

    header: Header
    live: bool
    revision: int
    events: Sequence[Mapping[str, Any]]
    faults: Sequence[Mapping[str, Any]]
    fault_state: FaultState

    @property
    def times_s(self) -> Floats:
        """``(T,)`` simulated time of every instant, rising."""
        ...

    @property
    def states(self) -> Floats:
        """``(T, m, 6)`` states of the parcels at every instant; NaN while a parcel is absent."""
        ...

    def at(self, index: int) -> Instant:
        """Return one instant."""
        ...

    def speeds_of(self, cell: int, indices: Ints) -> Floats:
        """Return the wheel speeds of a cell at some instants, ``(k, 2)``, m/s."""
        ...

    def register_names(self) -> Sequence[str]:
        """Return the names of the registers that ``registers`` can return."""
        ...

    def registers(self, index: int) -> tuple[float, Mapping[str, NDArray[Any]]]:
        """Return the latest registers at an instant: their time, s, and by name ``(n, ...)``; maybe none."""
        ...

    def register_series(self, name: str, cell: int) -> tuple[Floats, Floats]:
        """Return the times, ``(R,)``, and the numbers of a cell's register, ``(R, k)``."""
        ...

    def run_state(self) -> RunState:
        """Return the state of the run."""
        ...

    def poll(self) -> None:
        """Take what has arrived; never waits."""
        ...

    def allows(self, operation: str) -> bool:
        """Whether the run can be asked to ``control``, ``fault`` or ``move``."""
        ...

    def request(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send a request to the run and return the answer; may wait, and runs in a thread of its own.

        Raises:
            DeployError: The run refuses, or doesn't answer.
        """
        ...

    def close(self) -> None:
        """Release what the source holds."""
        ...
