"""Colours of the page, light and dark, told apart by colour-blind readers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.util.colours import COLOURS

STEPS: Final = 256
"""Colours of a scale."""


@final
@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of one theme, as ``#rrggbb``.

    Attributes:
        paper: Background of the map and the plots.
        ink: Text and outlines.
        soft: Secondary text and axes.
        line: Grid lines.
        arrow: Wheel velocities.
        dead: Dead cells, with a cross.
        faulty: Rim of faulty cells.
        captured: Rim of cells at a captured edge.
        message: Links that carried messages.
        scale: Stops of the scale, from least to most, of falling or rising lightness alone.
        kinds: Colours of categories, in turn.
        lines: Colours of parcels and of a plot's lines, in turn.
    """

    paper: str
    ink: str
    soft: str
    line: str
    arrow: str
    dead: str
    faulty: str
    captured: str
    message: str
    scale: tuple[str, ...]
    kinds: tuple[str, ...]
    lines: tuple[str, ...]


LIGHT: Final = Theme(
    paper="#ffffff",
    ink="#22272e",
    soft="#5b6570",
    line="#e6eaef",
    arrow="#2c3642",
    dead="#c1121f",
    faulty="#d55e00",
    captured="#332288",
    message="#009e73",
    scale=("#eef1f5", "#d3e3f2", "#acccea", "#7fb2de", "#5597cf", "#2f7cbd"),
    kinds=("#eceff3", "#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00"),
    lines=COLOURS,
)
DARK: Final = Theme(
    paper="#12161c",
    ink="#e8edf3",
    soft="#9aa7b5",
    line="#2a323d",
    arrow="#c5d0dc",
    dead="#ff6b6b",
    faulty="#ff9f45",
    captured="#c9b6ff",
    message="#3ddc9f",
    scale=("#20272f", "#1e3a54", "#1f5279", "#236b9f", "#3484c0", "#56a0d8"),
    kinds=("#232b35", "#e69f00", "#56b4e9", "#2fc28f", "#e39cc4", "#f0e442", "#4c9be8", "#ff8c42"),
    lines=("#5bb3f0", "#ff9a4d", "#2fc28f", "#e39cc4", "#d8b33a", "#a99bff", "#9ad4f5"),
)


def theme_of(*, dark: bool) -> Theme:
    """Return the theme."""
    return DARK if dark else LIGHT


def rgba(colour: str) -> np.uint32:
    """Return a colour as Bokeh's images have it: little-endian red, green, blue, opaque."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return np.uint32(red | green << 8 | blue << 16 | 0xFF << 24)


def scale_of(theme: Theme) -> NDArray[np.uint32]:
    """Return the scale of a theme, ``(STEPS,)`` colours as `rgba`."""
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in theme.scale], dtype=np.float64)
    at = np.linspace(0.0, len(stops) - 1.0, STEPS)
    parts = [np.interp(at, np.arange(len(stops)), stops[:, k]).round().astype(np.uint32) for k in range(3)]
    return (parts[0] | parts[1] << 8 | parts[2] << 16 | np.uint32(0xFF << 24)).astype(np.uint32)
