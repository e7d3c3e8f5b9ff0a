"""Outlines of parcels and rails as compiled kernels read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant import geometry

Floats = NDArray[np.float64]


class Shapes(NamedTuple):
    """Outlines one after another, each about a point of its own.

    Attributes:
        corner: ``(b + 1,)`` where each one's corners begin, and where the last's end.
        vertices: ``(v, 2)`` m, counter-clockwise.
        normal: ``(v, 2)`` outward unit normals of the edges that begin there.
        offset: ``(v,)`` distance of those edges along them, m.
    """

    corner: NDArray[np.int64]
    vertices: Floats
    normal: Floats
    offset: Floats


def pack(outlines: Sequence[Floats]) -> Shapes:
    """Outlines ``(v, 2)`` each, side by side; two corners are a segment."""
    sides = [geometry.edges(outline) for outline in outlines]
    return Shapes(
        np.cumsum([0, *(len(outline) for outline in outlines)], dtype=np.int64),
        np.concatenate([np.zeros((0, 2)), *outlines]),
        np.concatenate([np.zeros((0, 2)), *(normal for normal, _ in sides)]),
        np.concatenate([np.zeros(0), *(offset for _, offset in sides)]),
    )
