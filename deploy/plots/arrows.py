"""Arrows of a map's cells, and their scale."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ACROSS: Final = 26
"""Most arrows along the longer side of a map."""


class ArrowGrid(NamedTuple):
    """Cells of a map that have an arrow: every k-th each way where the array is large.

    Attributes:
        shown: Whether each cell has an arrow, ``(n,)``.
        reach_m: Room of an arrow, m.
        extent_m: Longer side of the array, m.
    """

    shown: NDArray[np.bool_]
    reach_m: float
    extent_m: float

    @classmethod
    def of(cls, cells: Sequence[tuple[int, int]], pitch_m: float) -> ArrowGrid:
        """Return the cells with arrows of an array, whose cells are ``(row, column)``."""
        places = np.array(cells).reshape(-1, 2)
        across = int(np.ptp(places, axis=0).max()) + 1
        stride = -(-across // _ACROSS)
        shown = ((places - stride // 2) % stride == 0).all(axis=1)
        # With an even stride no cell is in the middle: arrows as long as the stride would stick out of the array.
        return cls(shown, (stride - 1 + stride % 2) * pitch_m, across * pitch_m)


def draw_arrows(
    axes: Axes,
    grid: ArrowGrid,
    positions_m: NDArray[np.float64],
    vectors: NDArray[np.float64],
    longest: float,
    colour: str,
    scale: tuple[str, str] = ("wheels", "m/s"),
    *,
    zorder: float = 2,
) -> Any:
    """Draw the arrows of a map, with an arrow of a round size above its right corner.

    Args:
        axes: Axes of the map.
        grid: Cells with arrows.
        positions_m: Positions of the arrows, ``(k, 2)``, m.
        vectors: Their sizes, ``(k, 2)``.
        longest: Size of an arrow that fills its room.
        colour: Colour of arrows and words.
        scale: Meaning of the arrows, and the unit of their size.
        zorder: Order of drawing.

    Returns:
        The arrows, as ``Axes.quiver`` returns them.
    """
    corners = list(zip(axes.get_xlim(), axes.get_ylim(), strict=True))
    axes.update_datalim(
        corners
    )  # quiver divides by the size of the data, which a single cell at 0, 0 has not
    arrows = axes.quiver(
        *positions_m.T,
        *vectors.T,
        angles="xy",
        pivot="mid",
        units="xy",
        scale_units="xy",
        scale=longest / (0.92 * grid.reach_m),
        width=min(0.055 * grid.reach_m, 0.004 * grid.extent_m),
        headwidth=4.0,
        headlength=4.6,
        headaxislength=4.1,
        minlength=0.1,
        color=colour,
        linewidth=0,
        zorder=zorder,
    )
    size = round_below(longest)
    (left, _), (right, _) = corners
    length = 0.92 * grid.reach_m * size / longest / (right - left)
    axes.quiverkey(
        arrows,
        min(0.97, 1.03 - length),  # ends near the edge of the axes, in a small array, too
        1.02,
        size,
        f"{scale[0]}, {size:g} {scale[1]}",
        coordinates="axes",
        labelpos="W",
        labelsep=0.06,
        color=colour,
        labelcolor=colour,
        fontproperties={"size": 8},
    )
    return arrows


def round_below(value: float) -> float:
    """Return the greatest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (0.5, 1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-9))
