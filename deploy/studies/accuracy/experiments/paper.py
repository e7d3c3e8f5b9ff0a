"""The paper's three simulations, compared with the bundled scenes modelled on them."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, final

import numpy as np

from deploy.plots.map_view import INK, draw_map
from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.recordings.trace import RunTrace
from deploy.runs.field_simulation import field_speeds
from deploy.studies.accuracy.closed_form import closed_form
from deploy.studies.accuracy.experiments.markdown import GRID, Section, error, picture, power, prose, table
from deploy.studies.accuracy.experiments.runs import ExperimentTrace, run, scene_with
from deploy.studies.orientations.study import study
from deploy.util.colours import colour
from plant.analysis.equilibrium import linear_field
from plant.array import CellArray
from plant.friction.viscous import viscous_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.scenes.scene import Scene
    from plant.analysis.orientations import Orientation
    from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True)
class Oscillator:
    """``x'' = kappa (k x - x')`` from rest, k < 0, underdamped: eqs. 16-18 in a field ``V = k x``.

    Attributes:
        kappa: ``mu g``, 1/s.
        k: the field's rate along the axis, 1/s.
    """

    kappa: float
    k: float

    @property
    def natural_rad_s(self) -> float:
        """``sqrt(mu g |k|)``."""
        return float(np.sqrt(self.kappa * abs(self.k)))

    @property
    def damping(self) -> float:
        """``sqrt(mu g / |k|) / 2``; below 1 it swings."""
        return 0.5 * float(np.sqrt(self.kappa / abs(self.k)))

    @property
    def swing_rad_s(self) -> float:
        """At which it swings, damping included."""
        return self.natural_rad_s * float(np.sqrt(1.0 - self.damping**2))

    @property
    def overshoot(self) -> float:
        """Overshoot: first swing to the other side, over the initial displacement."""
        return float(np.exp(-np.pi * self.damping / np.sqrt(1.0 - self.damping**2)))

    @property
    def overshoot_s(self) -> float:
        """Time of the overshoot: half a period, s."""
        return float(np.pi / self.swing_rad_s)


_WIDTH, _HEIGHT, _MAP = 11.4, 5.35, 3.85
"""Of the page and of the square view at its left, inches."""


def draw_scene(
    track: RunTrace, closed_m: Sequence[Floats | None], stable: Sequence[Orientation], subtitle: str
) -> Figure:
    """Draw one simulation.

    Args:
        track: its trajectory.
        closed_m: x and y in closed form at the track's times; None where there is none.
        stable: angles and intervals that attract.
        subtitle: what was run.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=DPI, facecolor="white")
    view = figure.add_axes((0.72 / _WIDTH, 0.55 / _HEIGHT, _MAP / _WIDTH, _MAP / _HEIGHT))
    draw_map(view, track)
    view.set_xticks(np.arange(-1.0, 1.01, 0.5))
    view.set_yticks(np.arange(-1.0, 1.01, 0.5))
    each = (_MAP - 0.2) / 2
    left, across = 5.6, 5.45
    path, turn = (
        figure.add_axes((left / _WIDTH, low / _HEIGHT, across / _WIDTH, each / _HEIGHT))
        for low in (0.55 + each + 0.2, 0.55)
    )
    _draw_path(path, track, closed_m)
    _draw_turn(turn, track, stable)
    for axes in (path, turn):
        axes.grid(visible=True, color=GRID, lw=0.7)
        axes.set_axisbelow(True)
        axes.set_xlim(track.time_s[0], track.time_s[-1])
    path.tick_params(labelbottom=False)
    turn.set_xlabel("time (s)")
    figure.align_ylabels([path, turn])
    draw_heading(figure, track.title, subtitle, 0.35)
    return figure


def _draw_path(axes: Axes, track: RunTrace, closed_m: Sequence[Floats | None]) -> None:
    axes.axhline(0.0, color="#8b95a1", lw=0.8)
    for axis, name in enumerate("xy"):
        axes.plot(track.time_s, track.parcels[:, 0, axis], color=colour(axis), lw=1.7, label=name)
        closed = closed_m[axis]
        if closed is not None:
            label = "closed form" if axis == 1 else None
            axes.plot(track.time_s, closed, color=INK, lw=1.1, ls=(0, (2, 3)), label=label)
    axes.set_ylabel("x, y (m)")
    axes.legend(frameon=False, fontsize=8, loc="upper right")


def _draw_turn(axes: Axes, track: RunTrace, stable: Sequence[Orientation]) -> None:
    angle = np.degrees(track.parcels[:, 0, 2])
    axes.plot(track.time_s, angle, color=colour(2), lw=1.7)
    low, high = float(angle.min()), float(angle.max())
    room = 0.12 * (high - low) + 1.0
    axes.set_ylim(low - room, high + room)
    for one in stable:
        for turn in (-360.0, 0.0):
            ends = np.degrees((one.low_rad, one.high_rad)) + turn
            if ends[1] < low - room or ends[0] > high + room:
                continue
            axes.axhspan(max(float(ends[0]), low - room), float(ends[1]), color=colour(1), alpha=0.22, lw=0)
            axes.annotate(
                "attracting",
                (0.012, float(np.mean(np.clip(ends, low - room, high + room)))),
                xycoords=("axes fraction", "data"),
                ha="left",
                va="center",
                fontsize=7.5,
                color=colour(1),
            )
    axes.set_ylabel("angle (degrees)")


FIGURES = {"elliptic": "12", "misaligned": "13", "squeeze": "14"}
FILE = "paper_{}.png"
TOLERANCE = 1e-12
_SWINGS = (
    "scene",
    "axis",
    "damping ratio",
    "overshoot, closed form",
    "simulated",
    "at, s, closed form",
    "simulated",
    "off the closed form in 10 s, m",
)
_RESTS = ("scene", "angle at rest", "off the nearest axis", "attracting", "changes of supports in 10 s")
_SEEN = "the way of the parcel, x and y beside the closed form, and its angle"
_SETTLED_S = 60.0
"""Long enough for everything to have come to rest."""
_SAMPLE_S = 1e-3
_QUARTER = math.pi / 2.0


@final
@dataclass(frozen=True, slots=True)
class Swing:
    """One coordinate of the centre of mass.

    Attributes:
        axis: ``x`` or ``y``.
        oscillator: what it is; None where the field isn't linear.
        closed_m: ``(T,)`` where it is in closed form; None likewise.
        overshoot: how far it is seen to swing to the other side, over where it began; None: it doesn't.
        overshoot_s: when it is there, or is nearest to it.
        off_m: the farthest that it is from the closed form; None where there is none.
    """

    axis: str
    oscillator: Oscillator | None
    closed_m: Floats | None
    overshoot: float | None
    overshoot_s: float
    off_m: float | None


@final
@dataclass(frozen=True, slots=True)
class PaperRun:
    """Run of one scene.

    Attributes:
        scene: bundled.
        track: its trajectory, to be drawn.
        swings: of x and of y.
        settled: after a minute: x and y, m, and the angle, rad.
        rests_at: the attracting angle or interval in which that angle lies; None: in none.
        stable: all that attract.
        changes: of supports in the scene's duration.
    """

    scene: Scene
    track: RunTrace
    swings: Sequence[Swing]
    settled: tuple[float, float, float]
    rests_at: Orientation | None
    stable: Sequence[Orientation]
    changes: int

    @property
    def askew_rad(self) -> float:
        """Distance of the rest angle from the nearest axis of the field, rad."""
        angle = self.settled[2]
        return angle - _QUARTER * round(angle / _QUARTER)


def measure() -> list[PaperRun]:
    """All three scenes."""
    return [_simulation(name) for name in FIGURES]


def _simulation(name: str) -> PaperRun:
    scene = scene_with(name)
    solver = {"name": "exact", "tolerance": TOLERANCE}
    trace = run(scene, solver, sample_s=_SAMPLE_S)
    settled = run(scene_with(name, f"duration_s={_SETTLED_S}"), solver, sample_s=_SETTLED_S)
    x, y, angle = settled.state[-1, :3].tolist()
    stable = study(scene, 0, (x, y)).profile().stable()
    rests = next((one for one in stable if one.away_from(angle) < 1e-9), None)
    return PaperRun(
        scene, _track(scene, trace), _swings(scene, trace), (x, y, angle), rests, stable, trace.changes
    )


def _swings(scene: Scene, trace: ExperimentTrace) -> list[Swing]:
    positions = CellArray(scene.array).positions_m
    speeds = field_speeds(scene, positions)
    field, known = (
        linear_field(positions, speeds),
        closed_form(scene, speeds, trace.state[:1], trace.time_s),
    )
    kappa = viscous_of(scene.friction, "the paper's simulations").rate(scene.gravity_m_s2)
    swings: list[Swing] = []
    for axis, name in enumerate("xy"):
        offset, start = trace.state[:, axis], float(trace.state[0, axis])
        lowest = int(np.argmin(offset / start))
        across = -float(offset[lowest]) / start if offset[lowest] * start < 0.0 else None
        oscillator = None if field is None else Oscillator(kappa, float(field.rate_per_s[axis, axis]))
        closed = None if known is None else known[:, 0, axis]
        off = None if closed is None else float(np.max(np.abs(offset - closed)))
        swings.append(Swing(name, oscillator, closed, across, float(trace.time_s[lowest]), off))
    return swings


def _track(scene: Scene, trace: ExperimentTrace) -> RunTrace:
    array = CellArray(scene.array)
    return RunTrace(
        title=scene.title,
        scene=scene.name,
        pitch_m=array.pitch_m,
        cells=array.lattice.cells,
        positions_m=array.positions_m,
        footprints_m=(trace.footprint_m,),
        time_s=trace.time_s,
        parcels=trace.state[:, None],
        wheel_speeds=field_speeds(scene, array.positions_m),
        status="ok",
    )


def section(repeats: int) -> Section:
    """The section of the page; nothing in it is timed."""
    del repeats
    return describe(measure())


def describe(simulations: Sequence[PaperRun]) -> Section:
    """Describe the measurements in Markdown."""
    by_name = {one.scene.name: one for one in simulations}
    x, y = by_name["elliptic"].swings
    assert x.oscillator is not None
    assert y.oscillator is not None
    askew = {name: f"{math.degrees(one.askew_rad):.2f}°" for name, one in by_name.items()}
    pictures = [picture(FILE.format(name), f"{one.scene.title}: {_SEEN}") for name, one in by_name.items()]
    text = prose(
        "paper",
        damping_x=f"{x.oscillator.damping:.3f}",
        damping_y=f"{y.oscillator.damping:.3f}",
        **askew,
        pictures="\n\n".join(pictures),
        swings=table(_SWINGS, [_swing(one, swing) for one in simulations for swing in one.swings]),
        rests=table(_RESTS, [_rest(one) for one in simulations]),
        tolerance=power(TOLERANCE),
        sample=f"{_SAMPLE_S * 1e3:g}",
    )
    drawn = {FILE.format(name): partial(write_picture, partial(_draw, one)) for name, one in by_name.items()}
    return Section("The paper's three simulations", text, drawn)


def _draw(one: PaperRun) -> Figure:
    number, name = FIGURES[one.scene.name], one.scene.name
    facts = f"{name}  ·  after the paper's Fig. {number}, with values of ours  ·  {one.changes} changes of supports"
    return draw_scene(one.track, [swing.closed_m for swing in one.swings], one.stable, facts)


def _swing(one: PaperRun, swing: Swing) -> tuple[str, ...]:
    seen = "none" if swing.overshoot is None else f"{100.0 * swing.overshoot:.4f} %"
    at = "–" if swing.overshoot is None else f"{swing.overshoot_s:.3f}"
    own = swing.oscillator
    if own is None or swing.off_m is None:
        return (f"`{one.scene.name}`", swing.axis, "–", "–", seen, "–", at, "–")
    return (
        f"`{one.scene.name}`",
        swing.axis,
        f"{own.damping:.4f}",
        f"{100.0 * own.overshoot:.4f} %",
        seen,
        f"{own.overshoot_s:.3f}",
        at,
        error(swing.off_m),
    )


def _rest(one: PaperRun) -> tuple[str, ...]:
    rests = one.rests_at
    if rests is None:
        where = "none"
    elif rests.is_interval:
        low, high = math.degrees(rests.low_rad), math.degrees(rests.high_rad)
        turn = 360.0 if low > 180.0 else 0.0
        where = f"{low - turn:.4f}° to {high - turn:.4f}°"
    else:
        where = f"{math.degrees(rests.low_rad):.4f}°"
    return (
        f"`{one.scene.name}`",
        f"{math.degrees(one.settled[2]):.4f}°",
        f"{math.degrees(one.askew_rad):.4f}°",
        where,
        f"{one.changes:,}",
    )
