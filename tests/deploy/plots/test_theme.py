"""Formats of pictures by their suffix, and pages that hold all of their text."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from deploy.errors import InputError
from deploy.plots.theme import DPI, draw_heading, write_picture

WIDE_IN, HIGH_IN = 6.0, 4.0
FACTS = "  ·  ".join(f"fact {number} of a long subtitle" for number in range(6))


def _figure(title: str = "title", subtitle: str = "subtitle", label: str = "") -> Figure:
    figure = Figure(figsize=(WIDE_IN, HIGH_IN), dpi=DPI)
    axes = figure.add_axes((0.02, 0.2, 0.9, 0.5))
    axes.set_ylabel(label)
    draw_heading(figure, title, subtitle, 0.35)
    return figure


@pytest.mark.parametrize(
    ("name", "begins"),
    [("a.png", b"\x89PNG"), ("a.PDF", b"%PDF-"), ("a.svg", b"<?xml"), ("a.b.svg", b"<?xml")],
)
def test_the_suffix_decides_the_format_and_the_same_picture_is_the_same_file(
    tmp_path: Path, name: str, begins: bytes
) -> None:
    contents: list[bytes] = []
    for _ in range(2):
        write_picture(_figure, tmp_path / name)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0].startswith(begins)
    assert contents[0] == contents[1]
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["a.bmp", "a", "a.", ".png"])
def test_an_unknown_suffix_is_refused_by_name_before_anything_is_drawn(tmp_path: Path, name: str) -> None:
    def never() -> Figure:
        raise AssertionError

    with pytest.raises(InputError, match=rf"output .*{name}: a plot's name must end in .png, .svg or .pdf"):
        write_picture(never, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_page_is_as_large_as_it_was_made_unless_text_runs_beyond_it(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_picture(lambda: Figure(figsize=(WIDE_IN, HIGH_IN), dpi=DPI), path)
    assert imread(path).shape[:2] == (HIGH_IN * DPI, WIDE_IN * DPI)
    write_picture(lambda: _figure(label="a label left of the page"), path)
    assert imread(path).shape[1] > WIDE_IN * DPI


def test_titles_are_cut_and_subtitles_broken_between_facts_so_that_they_fit_the_page() -> None:
    figure = _figure("a title that is much too long for a page of this width " * 2, FACTS)
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    assert all(box.x1 <= WIDE_IN * DPI and box.y1 <= HIGH_IN * DPI for box in boxes)
    assert all(lower.y1 <= upper.y0 for upper, lower in pairwise(boxes))
    title, *lines = (text.get_text() for text in figure.texts)
    assert title.endswith("…")
    assert len(lines) > 1
    assert "  ·  ".join(lines) == FACTS
    assert _figure("short").texts[0].get_text() == "short"
