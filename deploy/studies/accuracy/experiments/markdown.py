"""Sections of the accuracy page and helpers that write Markdown."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, final

from deploy.plots.theme import DPI, draw_heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_HEAD, _FOOT, _LEFT, _RIGHT, _GAP = 0.98, 0.58, 0.82, 0.3, 0.95
"""Space around and between the panels, inches."""
GRID = "#e3e7ec"


def panels(
    title: str, subtitle: str, *, widths_in: Sequence[float], height_in: float
) -> tuple[Figure, list[Axes]]:
    """A figure with a heading and panels of these widths side by side, each with a light grid."""
    from matplotlib.figure import Figure

    width = _LEFT + sum(widths_in) + _GAP * (len(widths_in) - 1) + _RIGHT
    height = _HEAD + height_in + _FOOT
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    axes: list[Axes] = []
    left = _LEFT
    for each in widths_in:
        axes.append(figure.add_axes((left / width, _FOOT / height, each / width, height_in / height)))
        axes[-1].grid(visible=True, color=GRID, lw=0.7)
        axes[-1].set_axisbelow(True)
        left += each + _GAP
    draw_heading(figure, title, subtitle, 0.35)
    return figure, axes


PICTURES = "images/accuracy"
"""Where pictures are, seen from the page."""


@final
@dataclass(frozen=True, slots=True)
class Section:
    """Section of the page, with its text.

    Attributes:
        title: its heading.
        text: Markdown under it.
        pictures: what draws each into a file, by the name of that.
    """

    title: str
    text: str
    pictures: Mapping[str, Callable[[Path], None]] = field(default_factory=dict[str, Callable[[Path], None]])


def prose(name: str, **words: str) -> str:
    """A text of the page, with what was measured put in its places."""
    text = (resources.files("deploy.studies.accuracy") / "prose" / f"{name}.md").read_text(encoding="utf-8")
    return text.format(**words)


def table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; every column but the first is set to the right."""
    rule = ["---", *["---:"] * (len(heading) - 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (heading, rule, *rows))


def picture(name: str, says: str) -> str:
    """A picture in Markdown; ``says`` is read where it can't be seen."""
    return f"![{says}]({PICTURES}/{name})"


def milliseconds(spent_s: float) -> str:
    """A time, always followed by ``ms``: it marks what every run measures again."""
    return f"{spent_s * 1e3:.3g} ms" if spent_s < 0.0995 else f"{spent_s * 1e3:,.0f} ms"


def power(value: float) -> str:
    """``1e-6`` for a setting."""
    mantissa, _, exponent = f"{value:g}".partition("e")
    if not exponent:
        return mantissa if value > 1e-3 else f"{value:.0e}".replace("e-0", "e-")
    return f"{mantissa}e{int(exponent)}"


def error(value: float) -> str:
    """``1.1e-5``: an error, to the digits that two runs agree in."""
    if value == 0.0:
        return "0"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(exponent)}"
