"""The paper's three simulations, and what the bundled scenes after them do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, final

import numpy as np

from deploy.accuracy.closed_form import closed_form
from deploy.accuracy.evidence.oscillator import Oscillator
from deploy.accuracy.evidence.paper_picture import draw_scene
from deploy.accuracy.evidence.runs import Run, run, scene_with
from deploy.accuracy.evidence.section import Section, error, picture, power, prose, table
from deploy.orientations.study import study
from deploy.picture import write_picture
from deploy.simulate import field_speeds
from deploy.track import Track
from plant.array import CellArray
from plant.continuum import linear_field
from plant.friction.viscous import viscous_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.scene import Scene
    from plant.orientations import Orientation
    from plant.wheels import Floats

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
class Simulation:
    """One scene, run.

    Attributes:
        scene: bundled.
        track: its course, to be drawn.
        swings: of x and of y.
        settled: after a minute: x and y, m, and the angle, rad.
        rests_at: the attracting angle or interval in which that angle lies; None: in none.
        stable: all that attract.
        changes: of supports in the scene's duration.
    """

    scene: Scene
    track: Track
    swings: Sequence[Swing]
    settled: tuple[float, float, float]
    rests_at: Orientation | None
    stable: Sequence[Orientation]
    changes: int

    @property
    def askew_rad(self) -> float:
        """How far the angle of rest is from the nearest axis of the field."""
        angle = self.settled[2]
        return angle - _QUARTER * round(angle / _QUARTER)


def measure() -> list[Simulation]:
    """All three scenes."""
    return [_simulation(name) for name in FIGURES]


def _simulation(name: str) -> Simulation:
    scene = scene_with(name)
    solver = {"name": "exact", "tolerance": TOLERANCE}
    course = run(scene, solver, sample_s=_SAMPLE_S)
    settled = run(scene_with(name, f"duration_s={_SETTLED_S}"), solver, sample_s=_SETTLED_S)
    x, y, angle = settled.state[-1, :3].tolist()
    stable = study(scene, 0, (x, y)).profile().stable()
    rests = next((one for one in stable if one.away_from(angle) < 1e-9), None)
    return Simulation(
        scene, _track(scene, course), _swings(scene, course), (x, y, angle), rests, stable, course.changes
    )


def _swings(scene: Scene, course: Run) -> list[Swing]:
    positions = CellArray(scene.array).positions_m
    speeds = field_speeds(scene, positions)
    field, known = (
        linear_field(positions, speeds),
        closed_form(scene, speeds, course.state[:1], course.time_s),
    )
    kappa = viscous_of(scene.friction, "the paper's simulations").rate(scene.gravity_m_s2)
    swings: list[Swing] = []
    for axis, name in enumerate("xy"):
        way, start = course.state[:, axis], float(course.state[0, axis])
        lowest = int(np.argmin(way / start))
        across = -float(way[lowest]) / start if way[lowest] * start < 0.0 else None
        oscillator = None if field is None else Oscillator(kappa, float(field.rate_per_s[axis, axis]))
        closed = None if known is None else known[:, 0, axis]
        off = None if closed is None else float(np.max(np.abs(way - closed)))
        swings.append(Swing(name, oscillator, closed, across, float(course.time_s[lowest]), off))
    return swings


def _track(scene: Scene, course: Run) -> Track:
    array = CellArray(scene.array)
    return Track(
        title=scene.title,
        scene=scene.name,
        pitch_m=array.pitch_m,
        cells=array.lattice.cells,
        positions_m=array.positions_m,
        footprints_m=(course.footprint_m,),
        time_s=course.time_s,
        parcels=course.state[:, None],
        wheel_speeds=field_speeds(scene, array.positions_m),
        status="ok",
    )


def section(repeats: int) -> Section:
    """The section of the page; nothing in it is timed."""
    del repeats
    return describe(measure())


def describe(simulations: Sequence[Simulation]) -> Section:
    """What was measured, in words."""
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


def _draw(one: Simulation) -> Figure:
    number, name = FIGURES[one.scene.name], one.scene.name
    facts = f"{name}  ·  after the paper's Fig. {number}, with values of ours  ·  {one.changes} changes of supports"
    return draw_scene(one.track, [swing.closed_m for swing in one.swings], one.stable, facts)


def _swing(one: Simulation, swing: Swing) -> tuple[str, ...]:
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


def _rest(one: Simulation) -> tuple[str, ...]:
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
