"""Recordings in memory: arrays of a run, and quantities computed from these."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.recordings.changes import ChangeEncoded
from deploy.recordings.format import Header
from deploy.recordings.trace import RunTrace, mask_absent
from deploy.util.formatting import plural

if TYPE_CHECKING:
    import pandas as pd  # pyright: ignore[reportMissingTypeStubs]
    import xarray

    from deploy.recordings.exports.tables import TableName
    from deploy.recordings.message_trace import TracedMessage
    from deploy.recordings.quantities import RecordedTractions
    from plant.analysis.tractions import ArrayTractions


@final
@dataclass(frozen=True, eq=False)
class CellTrace:
    """Time series of a cell.

    Attributes:
        time_s: ``(T,)`` simulated time, s.
        presence: ``(T, sensors)`` bits of its presence sensors.
        drives: ``(T, 2)`` drives acting from each instant on.
        wheel_speeds: ``(T, 2)`` surface speeds of its wheels, m/s.
        register_tick: ``(R,)`` ticks of the registers.
        registers: ``(R, ...)`` each, by name.
    """

    time_s: NDArray[np.float64]
    presence: NDArray[np.bool_]
    drives: NDArray[np.float64]
    wheel_speeds: NDArray[np.float64]
    register_tick: NDArray[np.int64]
    registers: dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class ParcelTrace:
    """Time series of a parcel.

    Attributes:
        time_s: ``(T,)`` simulated time, s.
        position_m: ``(T, 2)`` centre of mass, m.
        angle_rad: ``(T,)`` orientation, rad.
        velocity_m_s: ``(T, 2)`` velocity, m/s.
        angular_velocity_rad_s: ``(T,)`` angular velocity, rad/s.
        events: Its events, in order.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    angle_rad: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    angular_velocity_rad_s: NDArray[np.float64]
    events: Sequence[dict[str, Any]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """A recording in memory. Rows are instants: the start of each tick and, of a complete run, the end.

    Attributes:
        path: The file.
        header: Header of the recording.
        tick: ``(T,)`` int64.
        time_ns: ``(T,)`` int64, simulated.
        parcels: ``(T, m, 6)`` states: x, y, angle, and their rates.
        held_presence: ``(n, sensors)`` bool per change: what the cells sensed at the instant.
        held_drives: ``(n, 2)`` per change: the drives acting from the instant on; the end repeats the last.
        held_wheel_speeds: ``(n, 2)`` per change: the wheels' surface speeds at the instant, m/s.
        register_tick: ``(R,)`` int64, ticks after which the cells' registers were recorded; none unless requested.
        registers: Registers of all cells at these ticks, by name, ``(R, n, ...)``; zero for dead cells.
        message_tick: ``(M,)`` int64, ticks whose messages between cells were recorded; none unless requested.
        messages: Messages sent in these ticks: ``sent`` ``(M, n, 4)`` bool by side, and ``(M, n, 4)`` by field.
        trace_tick: ``(K,)`` int64, ticks of the trace of messages; none unless requested.
        trace: Messages that the programs of the traced cells read and sent in these ticks: ``cell`` ``(K, c)`` indices,
            ``stepped`` ``(K, c)``, ``received`` and ``sent`` ``(K, c, 4)`` by side, ``read.NAME`` and ``sent.NAME`` by
            field.
        events: Events of the plant.
        faults: Faults.
        control: Live commands.
        status: Final status of the run; None where the recording was cut before its end record.
        digest: Digest of the run, in hexadecimal; None where the recording has none.
        motion_digest: Digest of sensor bits, drives and parcel states alone; None where the recording has none.
    """

    path: Path
    header: Header
    tick: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    parcels: NDArray[np.float64]
    held_presence: ChangeEncoded
    held_drives: ChangeEncoded
    held_wheel_speeds: ChangeEncoded
    register_tick: NDArray[np.int64]
    registers: dict[str, NDArray[Any]]
    message_tick: NDArray[np.int64]
    messages: dict[str, NDArray[Any]]
    trace_tick: NDArray[np.int64]
    trace: dict[str, NDArray[Any]]
    events: Sequence[dict[str, Any]]
    faults: Sequence[dict[str, Any]]
    control: Sequence[dict[str, Any]]
    status: str | None
    digest: str | None
    motion_digest: str | None = None

    @property
    def complete(self) -> bool:
        """Whether the recording holds the whole of its run, however that ended."""
        return self.status is not None

    @property
    def time_s(self) -> NDArray[np.float64]:
        """``(T,)`` simulated time."""
        return self.time_ns.astype(np.float64) * 1e-9

    @cached_property
    def presence(self) -> NDArray[np.bool_]:
        """``(T, n, sensors)`` what the cells sensed at every instant."""
        return self.held_presence.all()

    @cached_property
    def drives(self) -> NDArray[np.float64]:
        """``(T, n, 2)`` the drives acting from every instant on."""
        return self.held_drives.all()

    @cached_property
    def wheel_speeds(self) -> NDArray[np.float64]:
        """``(T, n, 2)`` the wheels' surface speeds at every instant, m/s."""
        return self.held_wheel_speeds.all()

    def cell(self, row: int, column: int) -> CellTrace:
        """Return the time series of one cell.

        Raises:
            InputError: The array has no such cell.
        """
        cells = [(int(r), int(c)) for r, c in self.header["cells"]]
        if (row, column) not in cells:
            raise InputError(f"{self.path}: there is no cell {row},{column}")
        index = cells.index((row, column))
        registers = {name: array[:, index] for name, array in self.registers.items()}
        return CellTrace(
            self.time_s,
            self.held_presence.of(index),
            self.held_drives.of(index),
            self.held_wheel_speeds.of(index),
            self.register_tick,
            registers,
        )

    def parcel(self, number: int) -> ParcelTrace:
        """Return the time series of one parcel, counted from 0 in the order of the scene.

        Raises:
            InputError: There is no such parcel.
        """
        count = self.parcels.shape[1]
        if not 0 <= number < count:
            raise InputError(f"{self.path}: there is no parcel {number}; it has {count}")
        state = self.parcels[:, number]
        events = [event for event in self.events if event.get("parcel") == number]
        return ParcelTrace(self.time_s, state[:, :2], state[:, 2], state[:, 3:5], state[:, 5], events)

    @cached_property
    def _recorded_tractions(self) -> RecordedTractions:
        from deploy.recordings.quantities import RecordedTractions

        try:
            return RecordedTractions(self.header, self.events, self.faults)
        except (ValueError, LookupError, TypeError) as error:
            raise InputError(f"{self.path}: its scene is not one of this version: {error}") from error

    def tractions(self, instant: int) -> ArrayTractions:
        """Compute the loads on the cells, and the slips and tractions of the wheels, at one instant.

        The values are computed from the recorded states and wheel speeds by the scene's law and effects; see
        ``plant.analysis.tractions``.

        Args:
            instant: Row of ``time_s``; negative ones count from the end.

        Raises:
            InputError: The scene of the recording is not one of this version.
        """
        return self._recorded_tractions.at(
            float(self.time_s[instant]), self.parcels[instant], self.held_wheel_speeds.at(instant)
        )

    @property
    def left_out_effects(self) -> tuple[str, ...]:
        """Names of the scene's effects that change forces and that ``tractions`` does not include."""
        return self._recorded_tractions.left_out

    def traced_messages(self, cells: Collection[tuple[int, int]] | None = None) -> list[TracedMessage]:
        """Return the messages of a run with ``--trace-messages``: sent, read, late, altered or lost, and why.

        Args:
            cells: ``(row, column)`` of the cells whose messages are wanted; None: of all that were traced.
        """
        from deploy.recordings.message_trace import traced_messages

        return traced_messages(self.header, self.trace_tick, self.trace, self.faults, cells)

    def to_xarray(self) -> xarray.Dataset:
        """Return all values as a dataset with names, units and coordinates.

        Raises:
            InputError: xarray is not installed.
        """
        from deploy.recordings.exports.dataset import to_xarray

        return to_xarray(self)

    def to_pandas(self, table: TableName = "parcels") -> pd.DataFrame:
        """Return a table.

        Args:
            table: ``parcels``, with a row for each parcel at each instant; ``events``; ``faults``; or ``control``.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        from deploy.recordings.exports.tables import to_pandas

        return to_pandas(self, table)

    def __repr__(self) -> str:
        seconds = float(self.time_s[-1]) if len(self.tick) else 0.0
        size = f"{plural(len(self.header['cells']), 'cell')}, {plural(self.parcels.shape[1], 'parcel')}"
        return f"<Recording of {self.header['scene_name']}: {seconds:g} s, {size}, {self.status}>"

    def _repr_html_(self) -> str:
        """Representation in notebooks."""
        from deploy.recordings.notebook import recording_html

        return recording_html(self.run_trace(), self.digest, self.control)

    def run_trace(self) -> RunTrace:
        """Return the trace of the run for plots, with the final wheel speeds."""
        header = self.header
        footprints = [np.array(corners, dtype=np.float64) for corners in header["footprints_m"]]
        return RunTrace(
            title=header["title"],
            scene=header["scene_name"],
            pitch_m=header["pitch_m"],
            cells=[(row, column) for row, column in header["cells"]],
            positions_m=np.array(header["positions_m"], dtype=np.float64).reshape(-1, 2),
            footprints_m=footprints,
            time_s=self.time_s,
            parcels=mask_absent(
                self.parcels, self.time_s, header.get("own_parcels", len(footprints)), self.events
            ),
            exits=[
                (exit_["name"], np.array(exit_["corners_m"], dtype=np.float64))
                for exit_ in header.get("exits", ())
            ],
            wheel_speeds=self.held_wheel_speeds.at(-1) if len(self.tick) else None,
            events=self.events,
            faults=self.faults,
            rails_m=_rails(header["scene"]),
            status=self.status,
        )


def _rails(scene: dict[str, Any]) -> Sequence[Sequence[tuple[float, float]]]:
    """Return the corners of a scene's guide rails."""
    effects: dict[str, Any] = scene.get("effects") or {}
    contact: dict[str, Any] = effects.get("parcel_contact") or {}
    return contact.get("rails", ())
