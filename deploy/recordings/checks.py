"""Validation of a recording's content, which may come from any program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar, cast

from pydantic import BaseModel, Field, ValidationError

from deploy.recordings.format import Header

_Point = Annotated[list[float], Field(min_length=2, max_length=2)]
_Place = Annotated[list[int], Field(min_length=2, max_length=2)]


_Part = TypeVar("_Part", bound=BaseModel)


class _Exit(BaseModel):
    name: str
    corners_m: list[_Point]


class _Contact(BaseModel):
    rails: list[list[_Point]] = []


class _Effects(BaseModel):
    parcel_contact: _Contact | None = None


class _Scene(BaseModel):
    effects: _Effects | None = None


class _Header(BaseModel):
    """Header fields in use by the reader."""

    run: str
    title: str
    scene_name: str
    scene: _Scene
    period_ns: int
    pitch_m: float
    cells: list[_Place]
    positions_m: list[_Point]
    sensors_m: list[_Point]
    footprints_m: list[list[_Point]]
    own_parcels: Annotated[int, Field(ge=0)] = 0
    exits: list[_Exit] = []


class _Record(BaseModel):
    """Fields of an event, a fault or a command in use by the reader."""

    time_s: float
    kind: str


class _Lost(_Record):
    """A cell that died or was lost."""

    cell: _Place | None = None


class _Turning(_Record):
    """A fault that begins or ends."""

    phase: Literal["begins", "happens", "ends"]
    cells: list[_Place]


class RunEnd(BaseModel):
    """End record of a run.

    Attributes:
        status: Final status.
        digest: Digest, in hexadecimal; None without one.
        motion_digest: Motion digest; None without one.
    """

    status: str
    digest: str | None
    motion_digest: str | None = None


def check_header(header: object) -> Header:
    """Check the type of every header field that this program uses.

    Raises:
        ValueError: Names the field and the rule.
    """
    _check("the header", _Header, header)
    found = cast("Header", header)
    if len(found["cells"]) != len(found["positions_m"]):
        raise ValueError("the header must have a position for each cell")
    return found


def check_records(records: Sequence[object]) -> list[dict[str, Any]]:
    """Check the time and kind of events, faults or commands.

    Raises:
        ValueError: Names the field and the rule.
    """
    for record in records:
        _check("a record", _Record, record)
    return cast("list[dict[str, Any]]", records)


def check_faults(records: Sequence[object]) -> list[dict[str, Any]]:
    """Check the time, kind and affected cells of faults.

    Raises:
        ValueError: Names the field and the rule.
    """
    for record in records:
        _check("a fault", _Turning if _has_phase(record) else _Lost, record)
    return cast("list[dict[str, Any]]", records)


def _has_phase(record: object) -> bool:
    return isinstance(record, dict) and "phase" in record


def check_traffic(events: Sequence[Mapping[str, Any]], parcels: int) -> None:
    """Check that events ``fed`` and ``left`` name one of ``parcels`` parcels.

    Raises:
        ValueError: An event names no such parcel.
    """
    for event in events:
        if event["kind"] in ("fed", "left"):
            parcel = event.get("parcel")
            if type(parcel) is not int or not 0 <= parcel < parcels:
                raise ValueError(f"an event {event['kind']} must name one of {parcels} parcels")


def check_end(record: object) -> RunEnd:
    """Check the end record of a run, and return it.

    Raises:
        ValueError: Names the field and the rule.
    """
    return _check("the end", RunEnd, record)


def _check(what: str, kind: type[_Part], value: object) -> _Part:
    try:
        return kind.model_validate(value, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise ValueError(f"{what}{place and ': ' + place}: {first['msg']}") from None
