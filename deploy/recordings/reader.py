"""Reader of recordings, whole or cut."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.recordings.format import (
    CONTROL,
    END,
    EVENTS,
    FAULTS,
    FILE_NAME,
    HEADER_RECORD,
    MESSAGES,
    PROFILE,
    READABLE,
    REGISTERS,
    TICK,
    TRACE,
    Header,
)
from deploy.recordings.trace import RunTrace, mask_absent
from deploy.util.formatting import plural

if TYPE_CHECKING:
    import pandas as pd  # pyright: ignore[reportMissingTypeStubs]
    import xarray

    from deploy.recordings.exports.tables import TableName
    from deploy.recordings.mcap_reader import Note
    from deploy.recordings.message_trace import TracedMessage
    from deploy.recordings.quantities import RecordedTractions
    from plant.analysis.tractions import ArrayTractions

_Read = TypeVar("_Read")


@final
@dataclass(frozen=True, eq=False)
class ChangeEncoded:
    """A field that is written only when it changes: the written values, and an index by instant.

    Attributes:
        values: Written values, ``(changes, ...)``.
        index: Row of ``values`` at each instant, ``(T,)`` int64.
    """

    values: NDArray[Any]
    index: NDArray[np.int64]

    def at(self, instant: int) -> NDArray[Any]:
        """Return the value at one instant."""
        return self.values[self.index[instant]]

    def all(self) -> NDArray[Any]:
        """Return the values at every instant, ``(T, ...)``."""
        return self.values[self.index]


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
            self.presence[:, index],
            self.drives[:, index],
            self.wheel_speeds[:, index],
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


def load(path: str | Path) -> Recording:
    """Load a recording, whole or cut.

    Args:
        path: The file, or the output folder it is in.

    Raises:
        InputError: There is no such file, it is no recording, it is corrupt before its end, or it was cut
            before it said what it is a recording of.
    """
    return refusing_corruption(path, _load)


def refusing_corruption(path: str | Path, read: Callable[[Path], _Read]) -> _Read:
    """Return what ``read`` returns of a recording, with errors that name the file and the cause.

    Args:
        path: The file, or the output folder it is in.
        read: Takes the file.

    Raises:
        InputError: There is no such file, it can't be read, or it is corrupt.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / FILE_NAME).exists():
            raise InputError(f"there is no {FILE_NAME} in {path}")
        path = path / FILE_NAME
    try:
        return read(path)
    except OSError as error:
        raise InputError(f"can't read the recording {path}: {error.strerror or error}") from error
    except (ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"{path} is corrupt: {error}") from error


def _load(path: Path) -> Recording:
    import msgpack  # pyright: ignore[reportMissingTypeStubs]

    from deploy.recordings.checks import check_end, check_faults, check_records, check_traffic
    from deploy.recordings.mcap_reader import Message, scan

    unpack = cast(Callable[[bytes], object], msgpack.unpackb)  # pyright: ignore[reportUnknownMemberType]
    header: Header | None = None
    rows = _Rows()
    shown: list[dict[str, Any]] = []
    sent: list[dict[str, Any]] = []
    traced: list[dict[str, Any]] = []
    logs: dict[str, list[object]] = {EVENTS: [], FAULTS: [], CONTROL: [], END: []}
    for record in scan(path, PROFILE):
        if isinstance(record, Message):
            if record.topic == TICK:
                rows.add(record.time_ns, _map(unpack(record.data)))
            elif record.topic == REGISTERS:
                shown.append(_map(unpack(record.data)))
            elif record.topic == MESSAGES:
                sent.append(_map(unpack(record.data)))
            elif record.topic == TRACE:
                traced.append(_map(unpack(record.data)))
            elif record.topic in logs:
                logs[record.topic].append(json.loads(record.data))
        else:
            header = decode_header(path, record) or header
    if header is None:
        raise InputError(f"can't read the recording {path}: it holds no complete header")
    end = check_end(logs[END][-1]) if logs[END] else None
    events = check_records(logs[EVENTS])
    check_traffic(events, len(header["footprints_m"]))
    return Recording(
        path=path,
        header=header,
        events=events,
        faults=check_faults(logs[FAULTS]),
        control=check_records(logs[CONTROL]),
        status=None if end is None else end.status,
        digest=None if end is None else end.digest,
        motion_digest=None if end is None else end.motion_digest,
        register_tick=np.array([message["tick"] for message in shown], dtype=np.int64),
        registers=_stacked(shown, "registers"),
        message_tick=np.array([message["tick"] for message in sent], dtype=np.int64),
        messages=_stacked(sent, "messages"),
        trace_tick=np.array([message["tick"] for message in traced], dtype=np.int64),
        trace=_stacked(traced, "trace"),
        **rows.arrays(header),
    )


def _map(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError(f"a message is a {type(value).__name__}, not a map")
    return cast("dict[str, Any]", value)


def _stacked(shown: Sequence[dict[str, Any]], key: str) -> dict[str, NDArray[Any]]:
    """Stack recorded arrays by name; zero where one is missing or has another shape."""
    found: dict[str, NDArray[Any]] = {}
    for row, message in enumerate(shown):
        for name, (code, shape, data) in _map(message[key]).items():
            values = np.frombuffer(data, np.dtype(code)).reshape(shape)
            if name not in found:
                found[name] = np.zeros((len(shown), *values.shape), dtype=values.dtype)
            if found[name].shape[1:] == values.shape:
                found[name][row] = values
    return found


def _rails(scene: dict[str, Any]) -> Sequence[Sequence[tuple[float, float]]]:
    """Return the corners of a scene's guide rails."""
    effects: dict[str, Any] = scene.get("effects") or {}
    contact: dict[str, Any] = effects.get("parcel_contact") or {}
    return contact.get("rails", ())


def decode_header(path: Path, record: Note) -> Header | None:
    """Decode and check the header; None if the metadata record is another.

    Raises:
        InputError: The recording has another format, or fields are absent.
        ValueError: A field has the wrong type.
    """
    if record.name != HEADER_RECORD:
        return None
    values = record.values
    if values.get("format") not in [str(version) for version in READABLE]:
        raise InputError(
            f"{path} is a recording of format {values.get('format')}: this version reads formats "
            f"{' and '.join(map(str, READABLE))}"
        )
    from deploy.recordings.checks import check_header

    header = cast(Header, json.loads(values["json"]))
    absent = sorted(Header.__required_keys__ - set(header))
    if absent:
        raise InputError(f"{path} is not a recording of mdms: its header has no {', '.join(absent)}")
    return check_header(header)


_FIELDS = ("presence", "drives", "wheel_speeds", "parcels")


@final
class _Rows:
    """Messages of ``/tick``: an absent field keeps its previous value, and no wheel speeds are the drives before."""

    def __init__(self) -> None:
        self._ticks: list[int] = []
        self._times: list[int] = []
        self._written: dict[str, list[bytes]] = {name: [] for name in _FIELDS}
        self._index: dict[str, list[int]] = {name: [] for name in _FIELDS}

    def add(self, time_ns: int, message: dict[str, Any]) -> None:
        if type(message["tick"]) is not int:
            raise TypeError("a tick must be an integer")
        self._ticks.append(message["tick"])
        self._times.append(time_ns)
        if "wheel_speeds" in message and message["wheel_speeds"] is None:
            message["wheel_speeds"] = self._written["drives"][-1]
        for name in _FIELDS:
            written = self._written[name]
            if name in message:
                written.append(message[name])
            self._index[name].append(max(len(written) - 1, 0))

    def arrays(self, header: Header) -> dict[str, Any]:
        """Return the arguments of ``Recording`` that come from the ticks."""
        cells, sensors = len(header["cells"]), len(header["sensors_m"])
        return {
            "tick": np.array(self._ticks, dtype=np.int64),
            "time_ns": np.array(self._times, dtype=np.int64),
            "parcels": self._numbers("parcels", (len(header["footprints_m"]), 6)).all(),
            "held_presence": self._bits("presence", (cells, sensors)),
            "held_drives": self._numbers("drives", (cells, 2)),
            "held_wheel_speeds": self._numbers("wheel_speeds", (cells, 2)),
        }

    def _numbers(self, name: str, shape: tuple[int, int]) -> ChangeEncoded:
        width = shape[0] * shape[1]
        values = np.frombuffer(b"".join(self._joined(name, width * 8)), dtype="<f8")
        return self._held(name, values.astype(np.float64, copy=False).reshape(-1 if width else 1, *shape))

    def _bits(self, name: str, shape: tuple[int, int]) -> ChangeEncoded:
        width = shape[0] * shape[1]
        size = (width + 7) // 8
        joined = self._joined(name, size)
        rows = np.frombuffer(b"".join(joined), dtype=np.uint8).reshape(len(joined), size)
        bits = np.unpackbits(rows, axis=1, count=width, bitorder="little")
        return self._held(name, bits.astype(np.bool_).reshape(len(joined), *shape))

    def _joined(self, name: str, size: int) -> list[bytes]:
        """Return the written values of a field; one zero value for drives in a run of no ticks."""
        written = self._written[name]
        if any(len(values) != size for values in written):
            raise ValueError(f"{name} must be {size} bytes")
        return [bytes(size)] if self._ticks and not written else written

    def _held(self, name: str, values: NDArray[Any]) -> ChangeEncoded:
        return ChangeEncoded(values, np.array(self._index[name], dtype=np.int64))
