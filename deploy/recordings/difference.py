"""Difference of two recordings: the first tick, cell and quantity in which they differ, and what was compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES
from deploy.recordings.format import PARCEL_NUMBERS

if TYPE_CHECKING:
    from deploy.recordings.changes import ChangeEncoded
    from deploy.recordings.recording import Recording

ABSENT: Final = "absent"
"""Value of a key that a scene does not have."""


@final
@dataclass(frozen=True, slots=True)
class ValueDifference:
    """First difference of a quantity.

    Attributes:
        quantity: Name of the quantity, such as ``drives`` or ``register level``.
        tick: Tick of the difference.
        time_s: Time of its start, s.
        cell: Row and column; None of a parcel or a record.
        parcel: Number of the parcel; None of a cell or a record.
        part: Which of several numbers: an axis, a side, a name; empty of a single number.
        a: Value in the first recording; None: it has none.
        b: Value in the second recording.
        places: How many values of the quantity differ in this tick.
    """

    quantity: str
    tick: int
    time_s: float
    cell: tuple[int, int] | None
    parcel: int | None
    part: str
    a: Any
    b: Any
    places: int = 1


@final
@dataclass(frozen=True, slots=True)
class SceneDifference:
    """A value in which the scenes, or the versions, differ.

    Attributes:
        path: Dotted path in the scene; ``versions.NAME`` of a version.
        a: Value in the first recording; ``absent`` if it has none.
        b: Value in the second recording.
    """

    path: str
    a: Any
    b: Any


@final
@dataclass(frozen=True, slots=True)
class RecordingDifference:
    """Differences of two recordings.

    Attributes:
        scenes: Values in which scenes and versions differ.
        differences: First difference of each quantity, in order of ticks and, in a tick, of cause and effect.
        compared: Names of the compared quantities.
        unlike: What can't be compared, since arrays, parcels or ticks are other ones: a difference.
        left_out: What was not compared, since it is in one recording only.
        instants: Number of compared instants.
        ticks: Last tick of each recording; -1 without any.
    """

    scenes: tuple[SceneDifference, ...]
    differences: tuple[ValueDifference, ...]
    compared: tuple[str, ...]
    unlike: tuple[str, ...]
    left_out: tuple[str, ...]
    instants: int
    ticks: tuple[int, int]

    @property
    def same(self) -> bool:
        """Whether all is the same that both have: values, cells, parcels, length."""
        return not self.differences and not self.unlike and self.ticks[0] == self.ticks[1]


@final
@dataclass(frozen=True, slots=True)
class _Quantity:
    """A quantity of both recordings.

    Attributes:
        name: Name of the quantity.
        a: Values of the first by row of ``rows``; arrays whose first axis is the cell or parcel.
        b: Values of the second.
        rows: ``(k, 2)``, rows of both recordings at the same ticks.
        rank: Order in a tick: causes before effects.
        parts: Names of the numbers of a cell or a parcel, by axis.
    """

    name: str
    a: ChangeEncoded | NDArray[Any]
    b: ChangeEncoded | NDArray[Any]
    rows: NDArray[np.int64]
    rank: int
    parts: tuple[tuple[str, ...], ...] = ()


_AXES: Final = ("x", "y")


def compare(a: Recording, b: Recording) -> RecordingDifference:
    """Compare two recordings, tick by tick, as far as both go.

    Numbers are compared to the last bit, but for minus zero, which equals zero as in the digest, and NaN, which equals
    NaN.

    Args:
        a: First recording.
        b: Second recording.
    """
    scenes = tuple(_scene_differences(a, b))
    unlike, left_out = list[str](), list[str]()
    quantities = _quantities(a, b, unlike, left_out)
    found = [(one, rank) for quantity in quantities for one, rank in _first(a, quantity)]
    for name in ("events", "faults", "control"):
        found += [(one, 9) for one in _first_record(name, a, b)]
    found.sort(key=lambda pair: (pair[0].tick, pair[1]))
    names = [quantity.name for quantity in quantities] + ["events", "faults", "commands"]
    common = int(_common(a.tick, b.tick).shape[0]) if quantities else 0
    ticks = tuple(int(one.tick[-1]) if len(one.tick) else -1 for one in (a, b))
    return RecordingDifference(
        scenes,
        tuple(one for one, _ in found),
        tuple(names),
        tuple(unlike),
        tuple(left_out),
        common,
        (ticks[0], ticks[1]),
    )


def _quantities(a: Recording, b: Recording, unlike: list[str], left_out: list[str]) -> list[_Quantity]:
    """Return the comparable quantities; add to the lists what can't be compared."""
    found: list[_Quantity] = []
    if a.header["period_ns"] != b.header["period_ns"]:
        periods = " and ".join(f"{one.header['period_ns'] * 1e-9:g} s" for one in (a, b))
        unlike.append(f"all ticks: they last {periods}")
        return found
    rows = _common(a.tick, b.tick)
    if a.parcels.shape[1] == b.parcels.shape[1]:
        found.append(_Quantity("parcels", a.parcels, b.parcels, rows, 0, (PARCEL_NUMBERS,)))
    else:
        unlike.append(f"parcels: there are {a.parcels.shape[1]} and {b.parcels.shape[1]}")
    if a.header["cells"] != b.header["cells"]:
        count = " and ".join(str(len(one.header["cells"])) for one in (a, b))
        unlike.append(f"all of the cells: there are {count}, or others")
        return found
    found.append(_Quantity("wheel speeds", a.held_wheel_speeds, b.held_wheel_speeds, rows, 1, (_AXES,)))
    if len(a.header["sensors_m"]) == len(b.header["sensors_m"]):
        sensors = tuple(f"sensor {i}" for i in range(len(a.header["sensors_m"])))
        found.append(_Quantity("presence", a.held_presence, b.held_presence, rows, 2, (sensors,)))
    else:
        unlike.append("presence: the cells have other sensors")
    for title, kind, rank, parts in (
        ("register", ("register_tick", "registers"), 3, ()),
        ("message", ("message_tick", "messages"), 4, (SIDES,)),
    ):
        _recorded(a, b, title, kind, rank, parts, found, left_out)
    ending = rows[: len(rows) - _ends(a, b, rows)]
    found.append(_Quantity("drives", a.held_drives, b.held_drives, ending, 5, (_AXES,)))
    return found


def _ends(a: Recording, b: Recording, rows: NDArray[np.int64]) -> int:
    """Return 1 if the last common row is the end of a whole run, which has no drives of its own; else 0."""
    if not len(rows):
        return 0
    ends = [one.complete and int(row) == len(one.tick) - 1 for one, row in zip((a, b), rows[-1], strict=True)]
    return int(any(ends))


def _recorded(
    a: Recording,
    b: Recording,
    title: str,
    kind: tuple[str, str],
    rank: int,
    parts: tuple[tuple[str, ...], ...],
    found: list[_Quantity],
    left_out: list[str],
) -> None:
    """Add registers or messages, which a recording has only if they were asked for."""
    ticks, arrays = kind
    ours, theirs = getattr(a, arrays), getattr(b, arrays)
    if not ours and not theirs:
        return
    if not ours or not theirs:
        left_out.append(f"{title}s: recorded in {'the second' if theirs else 'the first'} only")
        return
    rows = _common(getattr(a, ticks), getattr(b, ticks))
    for name in sorted({*ours, *theirs}):
        if name not in ours or name not in theirs:
            left_out.append(f"{title} {name}: in {'the second' if name in theirs else 'the first'} only")
        elif ours[name].shape[1:] != theirs[name].shape[1:]:
            left_out.append(f"{title} {name}: of other shapes")
        else:
            found.append(_Quantity(f"{title} {name}", ours[name], theirs[name], rows, rank, parts))


def _common(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows of both at common ticks, ``(k, 2)``."""
    _, ours, theirs = np.intersect1d(a, b, return_indices=True)
    return np.stack((ours, theirs), axis=1).astype(np.int64)


def _first(a: Recording, quantity: _Quantity) -> Iterator[tuple[ValueDifference, int]]:
    """Yield the first difference of a quantity, if there is one, and its rank; ``a``: the first recording."""
    seen: tuple[int, int] | None = None
    ticks = a.register_tick if quantity.rank == 3 else a.message_tick if quantity.rank == 4 else a.tick
    for row_a, row_b in quantity.rows.tolist():
        pair = _written(quantity.a, row_a), _written(quantity.b, row_b)
        if pair == seen:
            continue
        seen = pair
        ours, theirs = _at(quantity.a, row_a), _at(quantity.b, row_b)
        differ = _differ(ours, theirs)
        if not differ.any():
            continue
        place = tuple(int(i) for i in np.argwhere(differ)[0])
        whose = place[0]
        tick = int(ticks[row_a])
        cell = None if quantity.rank == 0 else tuple(a.header["cells"][whose])
        yield (
            ValueDifference(
                quantity.name,
                tick,
                tick * a.header["period_ns"] * 1e-9,
                None if cell is None else (int(cell[0]), int(cell[1])),
                whose if quantity.rank == 0 else None,
                _part(quantity, place[1:]),
                ours[place].item(),
                theirs[place].item(),
                int(np.count_nonzero(differ)),
            ),
            quantity.rank,
        )
        return


def _written(values: ChangeEncoded | NDArray[Any], row: int) -> int:
    """Return a number that stays as long as a value is not written anew."""
    return row if isinstance(values, np.ndarray) else int(values.index[row])


def _at(values: ChangeEncoded | NDArray[Any], row: int) -> NDArray[Any]:
    return values[row] if isinstance(values, np.ndarray) else values.at(row)


def _differ(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    differ: NDArray[np.bool_] = a != b
    if a.dtype.kind == "f" and b.dtype.kind == "f":
        differ = differ & ~(np.isnan(a) & np.isnan(b))
    return differ


def _part(quantity: _Quantity, place: tuple[int, ...]) -> str:
    names = [
        quantity.parts[axis][i] if axis < len(quantity.parts) and i < len(quantity.parts[axis]) else str(i)
        for axis, i in enumerate(place)
    ]
    return ", ".join(names)


def _first_record(name: str, a: Recording, b: Recording) -> Iterator[ValueDifference]:
    """Yield the first record of a log in which the two differ."""
    until_s = min((float(one.time_s[-1]) for one in (a, b) if len(one.tick)), default=0.0)
    ours: Sequence[Mapping[str, Any]]
    ours, theirs = (
        [record for record in getattr(one, name) if record["time_s"] <= until_s] for one in (a, b)
    )
    for i in range(max(len(ours), len(theirs))):
        pair = [records[i] if i < len(records) else None for records in (ours, theirs)]
        if pair[0] == pair[1]:
            continue
        time_s = min(float(record["time_s"]) for record in pair if record is not None)
        tick = int(time_s * 1e9 // a.header["period_ns"])
        what = "commands" if name == "control" else name
        yield ValueDifference(what, tick, time_s, None, None, f"number {i}", pair[0], pair[1])
        return


def _scene_differences(a: Recording, b: Recording) -> Iterator[SceneDifference]:
    pairs = [
        ("", a.header["scene"], b.header["scene"]),
        ("versions", a.header["versions"], b.header["versions"]),
    ]
    for start, one, other in pairs:
        ours, theirs = dict(_leaves(one, start)), dict(_leaves(other, start))
        for path in dict.fromkeys((*ours, *theirs)):
            values = ours.get(path, ABSENT), theirs.get(path, ABSENT)
            if values[0] != values[1]:
                yield SceneDifference(path, *values)


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield plain values of nested tables by dotted path; none of an empty table or list, and none that is None."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():  # pyright: ignore[reportUnknownVariableType]
            yield from _leaves(inner, f"{path}.{key}" if path else str(key))  # pyright: ignore[reportUnknownArgumentType]
    elif isinstance(value, list) and value:
        for i, inner in enumerate(value):  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
            yield from _leaves(inner, f"{path}.{i}")
    elif value is not None and value != [] and value != {}:
        yield path, value
