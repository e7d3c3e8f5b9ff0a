"""Names of cells on the command line: single cells and rectangles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError

ALL: Final = "all"
"""Name of all cells."""
_RANGE: Final = re.compile(r"(\d{1,9}),(\d{1,9})(?:-(\d{1,9}),(\d{1,9}))?")


def select_cells(text: str, cells: Sequence[tuple[int, int]], option: str) -> NDArray[np.int64]:
    """Return the indices of the named cells, ascending.

    Args:
        text: ``all``, or names separated by spaces: cells such as ``3,4``, and rectangles such as ``3,0-3,9``.
        cells: ``(row, column)`` of all cells.
        option: Name of the option, for errors.

    Raises:
        InputError: A name is malformed, or no cell has it.
    """
    if text == ALL:
        return np.arange(len(cells))
    places = np.array(cells, dtype=np.int64).reshape(-1, 2)
    chosen = np.zeros(len(cells), dtype=np.bool_)
    for name in text.split():
        match = _RANGE.fullmatch(name)
        if match is None:
            raise InputError(
                f"{option} {name}: must be {ALL}, a cell's row and column such as 1,2, or a rectangle such as 1,0-1,5"
            )
        corners = np.array([match[1], match[2], match[3] or match[1], match[4] or match[2]], dtype=np.int64)
        low, high = np.minimum(corners[:2], corners[2:]), np.maximum(corners[:2], corners[2:])
        inside = ((places >= low) & (places <= high)).all(axis=1)
        if not inside.any():
            raise InputError(f"{option} {name}: the array has no such cell")
        chosen |= inside
    if not chosen.any():
        raise InputError(f"{option}: names no cell")
    return np.flatnonzero(chosen)
