"""Summary of a run, also as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.util.files import SUMMARY, write_text
from plant.observations import TrafficCount

if TYPE_CHECKING:
    from deploy.protocol_report.report import ProtocolReport


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ParcelOutcome:
    """Final position, velocity and state of a parcel.

    Attributes:
        state: ``waiting``, ``moving``, ``at_rest``, ``tipped``, ``off_array`` or ``delivered``.
        time_s: Simulated time at which the state began, s.
        detail: More on the state, such as the edge about which the parcel tipped.
    """

    position_m: tuple[float, float]
    angle_rad: float
    velocity_m_s: tuple[float, float]
    angular_velocity_rad_s: float
    state: str
    time_s: float
    detail: str = ""

    @classmethod
    def of(cls, numbers: NDArray[np.float64], state: str, time_s: float, detail: str = "") -> ParcelOutcome:
        """Create the outcome from the six numbers of a parcel's state: x, y, angle, and their rates."""
        x, y, angle, vx, vy, omega = (float(number) for number in numbers)
        return cls(
            position_m=(x, y),
            angle_rad=angle,
            velocity_m_s=(vx, vy),
            angular_velocity_rad_s=omega,
            state=state,
            time_s=time_s,
            detail=detail,
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ProtocolMessages:
    """Messages between the programs of neighbouring cells, over any transport.

    Cells whose process was killed from outside are not in the counts.

    Attributes:
        sent: Messages that programs gave to a link with a neighbour at its end.
        received: Messages that programs received. Messages that were lost or replaced, or are on their way as the run
            ends, are sent and not received.
    """

    sent: int
    received: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Messages:
    """Payloads on the bus, and the cells' own messages apart from them.

    A payload is a frame of the lockstep: senses, drives, or all messages across one border in one tick. Messages within
    a process need no payload.

    Attributes:
        sent: Payloads put, once for every receiver.
        delivered: Payloads taken in.
        lost: Payloads waited for and given up.
        late: Payloads of a tick that was over, or of a cell given up before.
        protocol: The cells' own messages; None where their firmware has none.
        denied: Payloads, subscriptions, tokens and queries that somebody had no leave for.
        malformed: Payloads that could not be read.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    late: int = 0
    denied: int = 0
    malformed: int = 0
    protocol: ProtocolMessages | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """The outcome of ``mdms run`` or ``mdms simulate``.

    Attributes:
        status: ``ok``, ``failed``, ``stalled``, ``unstable`` or ``interrupted``.
        reason: Why not ``ok``: what failed and where, one line.
        scene: Name of the bundled scene, or the file.
        duration_s: Requested simulated time.
        simulated_s: Simulated time reached.
        cells: How many.
        firmware: The cells' program: ``name``, ``form`` (on arrays, or cell by cell), ``message_bytes`` (0: they don't
            talk); None without cells.
        processes: Worker processes; 0 where everything ran in one process.
        transport: ``zenoh``, ``memory``, or None without a bus.
        solver: ``name``, and ``tolerance`` or ``step_s``.
        events_left_out: Events of parcels that are listed nowhere, as there were too many of one parcel in one call of
            the solver. An ``outrun`` among them is missing from ``law_not_valid``.
        law_not_valid: Of each parcel that outran a wheel which the friction law takes to be faster: ``parcel`` and
            ``since_s``, in the order of time.
        captured: Where chatter was captured, so that positions are right to ``capture_m`` and not to the solver's
            tolerance: ``capture_m``, and ``parcels``; None: it was not.
        wall_s: The run itself, without start-up.
        support_changes: How often a cell came under or out from under a parcel's load.
        faults: Scheduled, live and found: each at least ``time_s`` and ``kind``.
        cells_lost: ``(row, column)`` of each.
        refused: Of what was denied or malformed ``why`` and ``what``, ``whose`` it was, and the ``number``; connections
            that were turned away, too.
        feeders: What came and went; None where the scene has no feeders.
        warnings: What the firmware said before the run will go wrong, a line each.
        effects: What effects of the cells did to cells that lived, by ``effect.what``, of all processes that said so:
            one that is killed from outside does not.
        protocol: What the cells' protocol did, held against theory; None unless requested.
        check: Violations of the program's invariants: ``violations``, ``by_rule``, and the ``first`` of them; None
            unless requested.
        digest: See ``deploy/recordings/digest.py``; None where there is none.
        motion_digest: Digest of sensor bits, drives and parcel states alone, without the scene; None where there is
            none.
        resumed: Ticks before which the run was taken up again from a checkpoint, in order; what was done twice counts
            once, in ``wall_s`` too.
        output: The folder with everything the run left behind; None where it left nothing.
    """

    status: str
    scene: str
    seed: int
    duration_s: float
    simulated_s: float
    cells: int
    processes: int
    transport: str | None
    solver: Mapping[str, str | float]
    ticks: int
    wall_s: float
    startup_s: float
    parcels: Sequence[ParcelOutcome]
    support_changes: int
    events_left_out: int = 0
    law_not_valid: Sequence[Mapping[str, Any]] = ()
    captured: Mapping[str, Any] | None = None
    messages: Messages = field(default_factory=Messages)
    faults: Sequence[Mapping[str, Any]] = ()
    cells_lost: Sequence[tuple[int, int]] = ()
    refused: Sequence[Mapping[str, Any]] = ()
    feeders: TrafficCount | None = None
    warnings: Sequence[str] = ()
    effects: Mapping[str, int] = field(default_factory=dict[str, int])
    firmware: Mapping[str, str | int] | None = None
    protocol: ProtocolReport | None = None
    check: Mapping[str, Any] | None = None
    digest: str | None = None
    motion_digest: str | None = None
    resumed: Sequence[int] = ()
    output: str | None = None
    reason: str | None = None

    @property
    def ticks_per_s(self) -> float | None:
        """Ticks a second of wall time; None if it took no time."""
        return self.ticks / self.wall_s if self.wall_s > 0 else None

    @property
    def realtime_factor(self) -> float | None:
        """Simulated over wall time; None if it took no time."""
        return self.simulated_s / self.wall_s if self.wall_s > 0 else None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; numbers that are not finite (of an unstable run) are None."""
        numbers = asdict(self)
        numbers["ticks_per_s"] = self.ticks_per_s
        numbers["realtime_factor"] = self.realtime_factor
        return finite(numbers)

    def to_json(self, indent: int | None = None) -> str:
        """Return the JSON object as ASCII text, which every stdout can hold."""
        return json.dumps(self.to_dict(), indent=indent, allow_nan=False)

    def write(self, folder: str | Path) -> Path:
        """Write ``summary.json`` into the folder, whole or not at all.

        Raises:
            DeployError: It can't be written.
        """
        path = Path(folder) / SUMMARY
        write_text(path, self.to_json(indent=2) + "\n")
        return path


def finite(value: Any) -> Any:
    """Convert a value to JSON's types, with None for NaN and infinity."""
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return finite(value.tolist())  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    return value


@final
@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a run: its summary, and details of a failure.

    Attributes:
        summary: Summary of the run.
        detail: Several lines on a failure, such as a firmware's traceback; empty without a failure.
    """

    summary: Summary
    detail: str = ""
