"""Makes the gallery of the bundled scenes: a thumbnail of each, and docs/gallery.md.

    python tests/tools/gallery.py                # all of them, some minutes
    python tests/tools/gallery.py elliptic heat  # thumbnails of some; the page lists all

Each scene runs in this process, for its duration or SECONDS at most.
"""

from __future__ import annotations

import sys
import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.quiver import QuiverKey
from PIL import Image

from deploy.plots.map_view import draw_map, extent
from deploy.plots.theme import plot_style
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import bundled_names, load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

SECONDS = 8.0
ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
ACROSS = 3
WIDTH_IN, DPI, SHADES = 3.0, 100, 48

HEAD = """# Gallery

The bundled scenes, each as it moves in its first {seconds:g} s or less. `mdms run NAME` makes the whole plot, and
`python tests/tools/gallery.py` made this page. A ring is the start, a dot the end. There are
[other kinds of plots](running.md#plots).

"""


def shortened(name: str) -> Scene:
    """A scene, of no more than SECONDS."""
    scene = load_scene(name)
    if scene.duration_s <= SECONDS:
        return scene
    return load_scene(name, [Override(("duration_s",), SECONDS, "")])


def thumbnail(name: str) -> bytes:
    """Run a scene and return its map as a small PNG."""
    with tempfile.TemporaryDirectory() as folder:
        run(shortened(name), RunOptions(0, "memory", output=Path(folder), picture=False), quiet=True)
        track = load(folder).run_trace()
    left, right, bottom, top = extent(track)
    height = min(max(WIDTH_IN * (top - bottom) / (right - left), 0.5), WIDTH_IN)
    with plot_style():
        figure = Figure(figsize=(WIDTH_IN, height), dpi=DPI, facecolor="white")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        draw_map(axes, track)
        axes.set_axis_off()
        for artist in [*axes.texts, *axes.findobj(QuiverKey)]:
            artist.set_visible(False)
        canvas: Any = FigureCanvasAgg(figure)
        drawn = BytesIO()
        canvas.print_png(drawn)
    small = BytesIO()
    Image.open(drawn).convert("RGB").quantize(SHADES).save(small, "PNG", optimize=True)
    return small.getvalue()


def page() -> str:
    """The page, with every bundled scene that has a thumbnail."""
    cells = [
        f"![{name}](images/gallery/{name}.png)<br>**{name}**: {load_scene(name).title}"
        for name in bundled_names()
        if (IMAGES / f"{name}.png").exists()
    ]
    rows = [cells[i : i + ACROSS] for i in range(0, len(cells), ACROSS)]
    rows[-1] += [""] * (ACROSS - len(rows[-1]))
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return (
        HEAD.format(seconds=SECONDS) + "\n".join(["|" + " |" * ACROSS, "|" + "---|" * ACROSS, *lines]) + "\n"
    )


def main(names: list[str]) -> None:
    """Make the thumbnails of some scenes, or of all, and the page."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name in names or bundled_names():
        picture = thumbnail(name)
        (IMAGES / f"{name}.png").write_bytes(picture)
        print(f"{name}: {len(picture):,} bytes", flush=True)
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main(sys.argv[1:])
