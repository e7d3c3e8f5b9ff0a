"""Animations of a recording: the map view, or a field of all cells, over time, as MP4 or GIF."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

import shutil
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.faults.fault_state import DEAD, FaultState
from deploy.plots.arrows import ArrowGrid, draw_arrows
from deploy.plots.cell_values import CellValues, fastest_m_s
from deploy.plots.fields import cell_colours
from deploy.plots.map_view import (
    ARROW,
    CELL,
    INK,
    NUMBERED,
    cross_strokes,
    draw_crosses,
    draw_ground,
    extent,
    outline,
    white_rim,
)
from deploy.plots.overview import subtitle_of
from deploy.plots.theme import draw_heading, plot_style
from deploy.util.colours import colour
from deploy.util.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.recording import Recording

FORMATS: Final = ("mp4", "gif")
FRAMES_HZ: Final = 20
MOST_FRAMES: Final = 400
"""A longer run has its frames farther apart, and plays faster than real time."""
_DPI = 100


def check_animation(path: Path) -> None:
    """Refuse a file name that ends in no format of animations, and MP4 without an encoder.

    Raises:
        InputError: Names the rule.
    """
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        raise InputError(f"animation {path}: its name must end in .mp4 or .gif")
    if suffix == "mp4":
        _encoder(path)


def _encoder(path: Path) -> str:
    """Return the path of ffmpeg: the system's, else the one of imageio-ffmpeg."""
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        return import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise InputError(
            f"animation {path}: MP4 needs ffmpeg: install ffmpeg, or the extra video: pip install "
            "'mdms-emulator[video]'; a name that ends in .gif needs neither"
        ) from None


def draw_animation(recording: Recording, path: str | Path, values: CellValues | None = None) -> None:
    """Draw the map view over time. The file is written whole or not at all.

    Args:
        recording: The recording, whole or cut.
        path: The file to write, MP4 or GIF by its suffix.
        values: Values that colour the cells; None: which cells are covered colours them.

    Raises:
        InputError: The suffix names no format, there is no encoder, or the recording has no instant.
        DeployError: The file can't be written.
    """
    import matplotlib as mpl
    from matplotlib.animation import FFMpegWriter, PillowWriter

    path = Path(path)
    check_animation(path)
    if not len(recording.tick):
        raise InputError(f"{recording.path}: has no instant to animate")
    suffix = path.suffix.lower().removeprefix(".")
    with plot_style(), atomic_write(path) as draft:
        scene = _AnimatedMap(recording, values)
        # the writers go by the suffix, which a draft doesn't have
        named = draft.with_name(f"{draft.name}.{suffix}")
        settings: Any = {"animation.ffmpeg_path": _encoder(path)} if suffix == "mp4" else {}
        with mpl.rc_context(settings):
            writer: Any = (FFMpegWriter if suffix == "mp4" else PillowWriter)(fps=FRAMES_HZ)
            try:
                with writer.saving(scene.figure, str(named), _DPI):
                    for row in scene.rows.tolist():
                        scene.show(row)
                        writer.grab_frame()
                named.replace(draft)
            finally:
                named.unlink(missing_ok=True)


@final
class _AnimatedMap:
    """The map of a recording, whose parcels and wheels move, and whose cells change their colours.

    Args:
        recording: The recording.
        values: Values that colour the cells, with a bar; None: covered cells have another colour.

    Attributes:
        figure: The figure.
        rows: Instants of the frames.
    """

    def __init__(self, recording: Recording, values: CellValues | None = None) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._recording, self._track, self._values = recording, recording.run_trace(), values
        self.rows = _frames(recording.time_s)
        left, right, bottom, top = extent(self._track)
        ratio = (right - left) / (top - bottom)
        wide = min(max(5.4 * ratio, 3.0), 9.0)
        tall = min(max(wide / ratio, 1.2), 5.4)
        width, height = 0.85 + wide + (0.35 if values is None else 1.25), 1.0 + tall + 0.6
        # an even number of pixels, which MP4 asks for
        width, height = (2 * round(0.5 * _DPI * size) / _DPI for size in (width, height))
        self.figure: Figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white")
        FigureCanvasAgg(self.figure)
        axes: Any = self.figure.add_axes((0.85 / width, 0.6 / height, wide / width, tall / height))
        self._cells = draw_ground(axes, self._track)
        if values is not None:
            self._cells.set_cmap(cell_colours())
            self._cells.set_array(values.at(int(self.rows[0])))
            self._cells.set_clim(*values.limits(self.rows))
            beside: Any = (1.05 + wide) / width, 0.6 / height, 0.16 / width, tall / height
            bar = self.figure.add_axes(beside)
            self.figure.colorbar(self._cells, cax=bar, label=values.label)
        self._grid = ArrowGrid.of(self._track.cells, self._track.pitch_m)
        self._shown = self._grid.shown
        self._arrows = self._draw_arrows(axes)
        self._bodies = [
            axes.fill(
                *np.zeros((2, len(footprint))),
                fc=(colour(i), 0.3),
                ec=colour(i),
                lw=1.4,
                path_effects=white_rim(1.4),
                zorder=5,
            )[0]
            for i, footprint in enumerate(self._track.footprints_m)
        ]
        self._numbers = self._draw_numbers(axes)
        self._health = FaultState(self._track.cells)
        self._health.add(self._track.faults)
        self._crosses = draw_crosses(axes, self._track, ())
        self._time = axes.set_title("", loc="left", fontsize=9, color="#3a424c", pad=4)
        draw_heading(self.figure, self._track.title, subtitle_of(self._track), 0.35)

    def _draw_arrows(self, axes: Any) -> Any:
        """Arrows of the wheels, whose scale is that of the fastest wheel in all frames; None if no wheel turns."""
        held = self._recording.held_wheel_speeds
        fastest = fastest_m_s(speeds[self._shown] for speeds in held.each(self.rows))
        if fastest == 0.0:
            return None
        shade = ARROW if self._values is None else INK  # seen on colours, too
        return draw_arrows(
            axes,
            self._grid,
            self._track.positions_m[self._shown],
            held.at(int(self.rows[0]))[self._shown],
            fastest,
            shade,
        )

    def _draw_numbers(self, axes: Any) -> list[Any]:
        """Numbers of the parcels, where there are several and not too many."""
        from matplotlib.patheffects import withStroke

        count = len(self._track.footprints_m)
        if not 1 < count <= NUMBERED:
            return []
        style: dict[str, Any] = {
            "ha": "center",
            "va": "center",
            "color": INK,
            "fontweight": "bold",
            "zorder": 6,
        }
        style["path_effects"] = [withStroke(linewidth=2.0, foreground="white")]
        size = 9 if count <= 12 else 6.5
        return [axes.text(0, 0, str(i), fontsize=size, clip_on=True, **style) for i in range(count)]

    def show(self, row: int) -> None:
        """Draw one instant."""
        recording, track = self._recording, self._track
        self._time.set_text(f"{track.time_s[row]:.2f} s")
        if self._values is not None:
            self._cells.set_array(self._values.at(row))
        else:
            covered = np.any(recording.held_presence.at(row), axis=1)
            self._cells.set_facecolor([_COVERED if one else CELL for one in covered.tolist()])
        if self._arrows is not None:
            speeds = recording.held_wheel_speeds.at(row)[self._shown]
            self._arrows.set_UVC(*np.where(np.isfinite(speeds), speeds, 0.0).T)
        for parcel, body in enumerate(self._bodies):
            state = track.parcels[row, parcel]
            there = bool(np.isfinite(state).all())
            body.set_visible(there)
            if there:
                body.set_xy(outline(track.footprints_m[parcel], state))
            if self._numbers:
                self._numbers[parcel].set_visible(there)
                self._numbers[parcel].set_position(state[:2] if there else (0.0, 0.0))
        dead = np.flatnonzero(self._health.health(float(track.time_s[row])) == DEAD)
        self._crosses.set_segments(cross_strokes(track, dead.tolist()))


_COVERED = "#c5d5ea"


def _frames(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of the frames, at equal times."""
    count = int(np.clip((time_s[-1] - time_s[0]) * FRAMES_HZ, 1, MOST_FRAMES - 1)) + 1
    wanted = np.linspace(time_s[0], time_s[-1], count)
    return np.searchsorted(time_s, wanted - 1e-12).clip(max=len(time_s) - 1).astype(np.int64)
