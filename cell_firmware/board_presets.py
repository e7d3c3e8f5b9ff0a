"""Boards by name: the effects that make a scene's cells like one, each with settings that are realistic for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, cast, final

from pydantic import Discriminator, Tag, ValidationError, field_validator

from bus.spec import Spec

BoardName = Literal["hc11"]

BOARDS: Final[Mapping[BoardName, Mapping[str, Mapping[str, Any]]]] = {
    "hc11": {
        # crystals of +-50 ppm, and boards that were not switched on in the same instant
        "clock": {"error_ppm": 50.0},
        # 16 cycles a turn of the motor's shaft, all four edges counted by a decoder chip a wheel, gears of 30 to 1; the
        # processor's own pulse accumulator counts one edge of four, 480 a revolution
        "encoder": {"counts_per_revolution": 1920, "decoder": "hctl2016"},
        # output compare at 1 kHz: two channels cost a twentieth of the processor's time
        "pwm": {"levels": 2000},
        "fixed_point": {},
        # "9600" baud, which is 9,615, and a UART for each neighbour; see docs/board.md for the chip's own SCI
        "serial": {"baud": 9615},
        "sensor": {"debounce_ticks": 2},
        "cop": {"timeout_s": 0.065536},
    },
}
"""An MC68HC11 at 8 MHz. The papers give only its name; all settings are assumptions of this project."""


@final
class BoardSpec(Spec):
    """A board without some of its effects."""

    name: BoardName
    """Name of the board."""
    without: tuple[str, ...] = ()
    """Effects of the board that are left out."""

    @field_validator("without")
    @classmethod
    def _known(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        known = sorted({effect for board in BOARDS.values() for effect in board})
        for name in value:
            if name not in known:
                raise ValueError(f"no board has an effect {name}; boards have {', '.join(known)}")
        return value


def _written(value: Any) -> str:
    """Whether a board is written as its name or as a table: problems are then reported of that form alone."""
    return "name" if isinstance(value, str) else "table"


Board = Annotated[
    Annotated[BoardName, Tag("name")] | Annotated[BoardSpec, Tag("table")], Discriminator(_written)
]
"""A board by its name, or without some of its effects."""


def expand_preset(scene: Any) -> Any:
    """A scene's data with the effects of the board that it names written out, and the name gone.

    An effect's table in the scene stands instead of the board's. Data that is not as it should be is left as it is:
    validating it says why.
    """
    cells = _table(scene, "cells")
    board = None if cells is None else cells.get("board")
    effects = _table(scene, "effects", {})
    if cells is None or board is None or effects is None:
        return scene
    try:
        spec = BoardSpec.model_validate({"name": board} if isinstance(board, str) else board, strict=False)
    except ValidationError:
        return scene
    given = {name: dict(table) for name, table in BOARDS[spec.name].items() if name not in spec.without}
    return {
        **scene,
        "cells": {key: value for key, value in cells.items() if key != "board"},
        "effects": {**given, **effects},
    }


def _table(data: Any, key: str, absent: Any = None) -> dict[str, Any] | None:
    found: Any = cast("dict[str, Any]", data).get(key, absent) if isinstance(data, dict) else None
    return cast("dict[str, Any]", found) if isinstance(found, dict) else None
