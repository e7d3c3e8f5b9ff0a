"""What commands that ask about one parcel at a pose share: its option, and values made of several numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.errors import InputError

if TYPE_CHECKING:
    from deploy.scene import Scene

ParcelOption = Annotated[int, typer.Option("--parcel", metavar="N", help="Which parcel, counted from 0.")]


def check_parcel(scene: Scene, parcel: int) -> None:
    """Refuse a parcel that the scene doesn't have.

    Raises:
        InputError: It doesn't.
    """
    if not 0 <= parcel < len(scene.parcels):
        has = f"parcels 0..{len(scene.parcels) - 1}" if scene.parcels else "no parcels"
        raise InputError(f"scene {scene.name}: --parcel {parcel}: the scene has {has}")


def numbers(option: str, text: str, form: str) -> list[float]:
    """The value of an option that is several numbers.

    Args:
        option: Its name.
        text: Its value.
        form: What it should be, such as ``X,Y``: as many numbers as this has parts between commas.

    Raises:
        InputError: It is something else.
    """
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != len(form.split(",")) or not all(math.isfinite(number) for number in found):
        raise InputError(f"{option} {text}: must be {form}, numbers")
    return found
