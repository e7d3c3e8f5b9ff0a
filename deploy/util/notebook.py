"""Rich representations for notebooks: tables of facts, and drawings of an array with its parcels as SVG."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deploy.util.colours import colour

Floats = NDArray[np.float64]
_WIDE_PX: Final = 320
_MOST_CELLS: Final = 1000
"""Up to this many cells are drawn one by one."""


def facts_html(title: str, facts: Iterable[tuple[str, str]], picture: str = "") -> str:
    """Return a title, a table of names and values, and a picture beside the table.

    Args:
        title: Title, plain text.
        facts: Names and values, plain text.
        picture: An SVG element.
    """
    cell = '<td style="text-align:left">'
    rows = "".join(
        f"<tr>{cell}<b>{escape(name)}</b></td>{cell}{escape(value)}</td></tr>" for name, value in facts
    )
    return (
        f'<div><div style="font-weight:bold;margin:4px 0">{escape(title)}</div>'
        f'<div style="display:flex;gap:16px;align-items:flex-start"><table>{rows}</table>{picture}</div></div>'
    )


def array_svg(
    positions_m: Floats, pitch_m: float, outlines_m: Sequence[Floats], paths_m: Sequence[Floats] = ()
) -> str:
    """Return a view of an array from above.

    Args:
        positions_m: Centres of the cells, ``(n, 2)``, m.
        pitch_m: Distance of neighbouring cells, m.
        outlines_m: Corners of each parcel, ``(v, 2)``, m; NaN: not drawn.
        paths_m: Path of each parcel's centre of mass, ``(k, 2)``, m; NaN: not drawn.
    """
    if not len(positions_m):
        return ""
    low, high = positions_m.min(axis=0) - pitch_m, positions_m.max(axis=0) + pitch_m
    scale = _WIDE_PX / max(float((high - low).max()), 1e-12)
    width, height = (scale * (high - low)).tolist()

    def pixels(points: Floats) -> str:
        # up is down on a screen
        at = np.stack([points[:, 0] - low[0], high[1] - points[:, 1]], axis=1) * scale
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in at.tolist())

    half = 0.46 * pitch_m
    square = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    if len(positions_m) <= _MOST_CELLS:
        shapes = [square + centre for centre in positions_m]
    else:
        inner = np.array([low, high]) + 0.5 * pitch_m * np.array([[1.0], [-1.0]])
        (left, bottom), (right, top) = inner.tolist()
        shapes = [np.array([[left, bottom], [right, bottom], [right, top], [left, top]])]
    parts = [f'<polygon points="{pixels(shape)}" fill="#eceff3"/>' for shape in shapes]
    for parcel, path in enumerate(paths_m):
        there = path[np.isfinite(path).all(axis=1)]
        if len(there) > 1:
            parts.append(
                f'<polyline points="{pixels(there)}" fill="none" stroke="{colour(parcel)}" stroke-width="1.2"/>'
            )
    for parcel, outline in enumerate(outlines_m):
        if np.isfinite(outline).all():
            shade = colour(parcel)
            parts.append(
                f'<polygon points="{pixels(outline)}" fill="{shade}" fill-opacity="0.25" stroke="{shade}" '
                f'stroke-width="1.6"/>'
            )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.1f} {height:.1f}">{"".join(parts)}</svg>'
    )
