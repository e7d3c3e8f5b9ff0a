"""Scale of a map's arrows."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_scale(
    axes: Axes, arrows: Any, fastest: float, colour: str, words: str = "wheels", unit: str = "m/s"
) -> None:
    """Draw an arrow of a round size above the right corner of a map, with its size.

    Args:
        axes: Axes of the map.
        arrows: The map's arrows, as ``Axes.quiver`` returns them.
        fastest: Size of the longest arrow; the scale's arrow is at most as long.
        colour: Colour of arrow and words.
        words: Meaning of the arrows.
        unit: Unit of their size.
    """
    speed = round_below(fastest)
    axes.quiverkey(
        arrows,
        0.97,
        1.02,
        speed,
        f"{words}, {speed:g} {unit}",
        coordinates="axes",
        labelpos="W",
        labelsep=0.06,
        color=colour,
        labelcolor=colour,
        fontproperties={"size": 8},
    )


def round_below(value: float) -> float:
    """Return the greatest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (0.5, 1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9))
