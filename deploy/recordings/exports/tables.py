"""Tables of a recording: parcels, events, faults and commands, as columns."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from deploy.errors import InputError
from deploy.recordings.exports.dataset import present
from deploy.recordings.exports.extra import library
from deploy.recordings.exports.names import TableName
from deploy.recordings.format import PARCEL_NUMBERS

if TYPE_CHECKING:
    import pandas as pd  # pyright: ignore[reportMissingTypeStubs]

    from deploy.recordings.exports.source import RecordingSource


def to_pandas(recording: RecordingSource, table: TableName = "parcels") -> pd.DataFrame:
    """Return a table of a recording; see ``columns``.

    Raises:
        InputError: pandas is not installed, or there is no such table.
    """
    if table not in TABLES:
        raise InputError(f"table {table!r}: must be one of {', '.join(TABLES)}")
    pandas_ = library("pandas", "recording.to_pandas()")
    found = columns(recording, table)
    # whole numbers with gaps keep their type: pandas would make floats of them
    whole = {name for name, values in found.items() if _are_whole(values)}
    return pandas_.DataFrame(
        {
            name: pandas_.array(values, dtype="Int64") if name in whole else values
            for name, values in found.items()
        }
    )


def columns(recording: RecordingSource, table: str) -> dict[str, Any]:
    """Return the columns of a table, each an array or a list.

    ``parcels`` has a row for each parcel at each instant. ``events``, ``faults`` and ``control`` have a row for each
    record, with its keys as columns in the order of their first appearance. A value that is a list or an object is a
    JSON text. None: the record has no such key.
    """
    return TABLES[table](recording)


def _parcels(recording: RecordingSource) -> dict[str, Any]:
    instants, parcels, _ = recording.parcels.shape
    found: dict[str, Any] = {
        "tick": np.repeat(recording.tick, parcels),
        "time_ns": np.repeat(recording.time_ns, parcels),
        "time_s": np.repeat(recording.time_s, parcels),
        "parcel": np.tile(np.arange(parcels, dtype=np.int64), instants),
        "present": present(recording).ravel(),
    }
    for number, name in enumerate(PARCEL_NUMBERS):
        found[name] = np.ascontiguousarray(recording.parcels[:, :, number]).ravel()
    return found


def _records(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    names = list(dict.fromkeys(name for record in records for name in record)) or ["time_s", "kind"]
    return {name: [_plain(record.get(name)) for record in records] for name in names}


def _plain(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value


def _are_whole(values: Any) -> bool:
    """Whether a column is a list of whole numbers, perhaps with gaps."""
    return isinstance(values, list) and _all_whole(values)  # pyright: ignore[reportUnknownArgumentType]


def _all_whole(values: list[Any]) -> bool:
    return any(value is not None for value in values) and all(
        value is None or type(value) is int for value in values
    )


TABLES: Final[Mapping[str, Callable[[RecordingSource], dict[str, Any]]]] = {
    "parcels": _parcels,
    "events": lambda recording: _records(recording.events),
    "faults": lambda recording: _records(recording.faults),
    "control": lambda recording: _records(recording.control),
}
"""Every table and its columns."""
