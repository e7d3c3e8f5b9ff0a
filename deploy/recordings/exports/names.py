"""Default names of exports, beside the recording."""

from __future__ import annotations

from typing import Final, Literal

TableName = Literal["parcels", "events", "faults", "control"]

TABLE_NAMES: Final[tuple[TableName, ...]] = ("parcels", "events", "faults", "control")
"""Tables of a recording, each a file of the formats ``parquet`` and ``csv``."""

DEFAULT: Final = {"netcdf": "recording.nc", "parquet": "parquet", "csv": "csv", "foxglove": "foxglove.mcap"}
"""File of each format, or folder of the formats with a file a table."""

FILES: Final = (
    DEFAULT["netcdf"],
    DEFAULT["foxglove"],
    "foxglove.layout.json",
    *(f"{DEFAULT[form]}/{table}.{form}" for form in ("parquet", "csv") for table in TABLE_NAMES),
)
"""All files that exports write by default."""
