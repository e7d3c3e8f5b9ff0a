"""Colours of parcels, alike in plots and exports."""

from __future__ import annotations

from typing import Final

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8c6d00", "#332288", "#56b4e9")
"""One a parcel, in turn: after Okabe and Ito, distinguished by colour-blind readers and on light grey."""


def colour(parcel: int) -> str:
    """Return the colour of a parcel, ``#rrggbb``."""
    return COLOURS[parcel % len(COLOURS)]


def channels(shade: str) -> tuple[float, float, float]:
    """Return red, green and blue of ``#rrggbb``, from 0 to 1."""
    red, green, blue = (int(shade[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue
