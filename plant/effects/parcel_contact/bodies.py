"""Rigid bodies that can touch, parcels and rails, and their independent groups within a span."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.friction.law import Traction
from plant.kernels.contact import layout as to
from plant.parcel_spec import ParcelSpec
from plant.solver_api import Body
from plant.wheels import WheelMotion

Floats = NDArray[np.float64]

BOTH_AXES = math.sqrt(2.0)
"""The forces of a cell's two wheels are at right angles."""


def corner_pulls(
    traction: Traction,
    mass: Floats,
    inertia: Floats,
    radius: Floats,
    cells: Floats,
    gravity: float,
    drag: float = 0.0,
) -> Floats:
    """Bounds on the accelerations of parcels' corners under a law of traction; see ``plant.kernels.contact.ccd``.

    All forces add up at one end of the parcel, at the fastest slip: more than any motion comes to. Loads sum to the
    weight.

    Args:
        traction: the law.
        mass: ``(m,)`` kg.
        inertia: ``(m,)`` kg m², about the centre of mass.
        radius: ``(m,)`` m, of the farthest corner.
        cells: ``(m,)`` how many fit under each.
        gravity: m/s².
        drag: of the rollers, s/m.

    Returns:
        ``(m, PULL_SIZE)``.
    """
    weight = mass * gravity
    yielding = BOTH_AXES * (1.0 / mass + radius * radius / inertia)
    stiffness = traction.stiffness_per_load * weight + traction.stiffness * cells
    bounds = np.zeros((len(mass), to.PULL_SIZE))
    bounds[:, to.PER_SLIP] = 1e300 if traction.set_valued else stiffness * yielding
    limit = traction.limit_per_load * weight + traction.limit * cells
    bounds[:, to.LIMIT] = traction.static_ratio * limit * yielding
    bounds[:, to.PUSH] = traction.push_per_load * weight * yielding
    bounds[:, to.UNLIMITED] = (traction.viscous * cells + drag * weight) * yielding
    bounds[:, to.RADIUS] = radius
    return bounds


def fastest(motion: WheelMotion) -> float:
    """Speed that no wheel's surface exceeds, along either axis, and that no cell's two wheels exceed together, m/s."""
    both = 0.0
    for part in (motion.steady, motion.decay):
        if part.size:
            both += max(float(part.max()), -float(part.min()))
    return BOTH_AXES * both


class Shapes(NamedTuple):
    """Outlines of bodies in flat arrays, each about its own reference point.

    Attributes:
        corner: ``(b + 1,)`` where each one's corners begin, and where the last's end.
        vertices: ``(v, 2)`` m, counter-clockwise.
        normal: ``(v, 2)`` outward unit normals of the edges that begin there.
        offset: ``(v,)`` distance of those edges along them, m.
    """

    corner: NDArray[np.int64]
    vertices: Floats
    normal: Floats
    offset: Floats


def pack(outlines: Sequence[Floats]) -> Shapes:
    """Outlines ``(v, 2)`` each, side by side; two corners are a segment."""
    sides = [geometry.edges(outline) for outline in outlines]
    return Shapes(
        np.cumsum([0, *(len(outline) for outline in outlines)], dtype=np.int64),
        np.concatenate([np.zeros((0, 2)), *outlines]),
        np.concatenate([np.zeros((0, 2)), *(normal for normal, _ in sides)]),
        np.concatenate([np.zeros(0), *(offset for _, offset in sides)]),
    )


Integers = NDArray[np.int64]


class Group(NamedTuple):
    """Group of bodies that may touch, numbered from 0 within the group.

    Attributes:
        names: numbers of the bodies in the scene, parcels before rails, ``(b,)``.
        moving: moving bodies, ascending, ``(g,)``; all other bodies stand.
        pairs: pairs that may touch, the smaller number first, ``(k, 2)``.
        shapes: outlines.
        inverse: inverse mass, 1/kg, and inverse moment of inertia, 1/(kg m²), ``(b, 2)``; 0 for standing bodies.
        pull: ``(b, PULL_SIZE)``: see ``plant.kernels.contact.ccd``.
        still: states of standing bodies, ``(b, 6)``.
        slow: closing speed up to which bodies don't bounce, m/s.
    """

    names: Integers
    moving: Integers
    pairs: Integers
    shapes: Shapes
    inverse: Floats
    pull: Floats
    still: Floats
    slow: float

    @property
    def parcels(self) -> Integers:
        """Scene numbers of the moving bodies, ``(g,)``."""
        return self.names[self.moving]

    def stopped(self, body: int, state: Floats) -> Group:
        """Return a copy of the group in which ``body`` stands still at ``state``."""
        inverse, still = self.inverse.copy(), self.still.copy()
        inverse[body] = 0.0
        still[body, :3] = state[:3]
        return self._replace(moving=self.moving[self.moving != body], inverse=inverse, still=still)


class ImpulseWorkspace(NamedTuple):
    """Contact problem of one island of ``c`` constraints and ``f`` faces; see ``plant.kernels.contact.problem``.

    Attributes:
        leader: a body of each body's island, ``(b,)``.
        until: end of the rows of each island, by its leader, ``(b,)``.
        island: leaders of the islands, ``(b,)``.
        row: rows, island by island, ``(2 f,)``.
        face: face of each row of the island, ``(2 f,)``.
        normal: first normal of each face, and the end of them all, ``(f + 1,)``.
        bodies: both bodies of each face, ``(f, 2)``.
        head: entry of each body's first face, ``(b,)``: twice the face, and which of its bodies.
        other: entry of the next face of the same body, ``(2 f,)``; -1 for none.
        arms: unit impulse of each constraint on both bodies, force and moment, ``(c, 6)``.
        lacking: motion along each constraint without impulses, less the motion wanted, ``(c,)``.
        yielding: motion along each constraint per unit impulse along itself, ``(c,)``, 1/kg.
        friction: Coulomb's coefficient of each face, ``(f,)``.
        held: nonzero where the tangent's motion is given whatever it takes, ``(f,)``.
        mode: mode of each constraint, ``(c,)``.
        selected: whether each impulse is unknown, ``(c,)``.
        order: faces along the island, ``(f,)``.
        seen: faces seen on the way, ``(f,)``.
        least, most: first and last unknown of each face, ``(f,)``.
        unknowns: constraints with unknown impulses, ``(c,)``.
        place: number of each constraint among the unknowns, ``(c,)``; -1 for none.
        slope: impulse across per normal impulse of each face that slides, ``(f,)``.
        system: banded system of the modes, see ``plant.kernels.contact.linear``.
        pivot: exchanged rows of its factors, ``(c,)``.
        push: normal impulse of each face, ``(f,)``.
        gained: motion of each body by impulses, ``(b, 3)``.
        impulse, start, trial, best, anchor, motion, solution: ``(c,)`` each.
        line: constraint and sense of each row of ``table``, ``(t, 2)``.
        table: dictionary of Lemke's method, ``(t, t + 3)``.
        basis, outside: its variables, ``(t,)`` and ``(t + 1,)``.
        tally: see ``plant.kernels.contact.layout``.
    """

    leader: Integers
    until: Integers
    island: Integers
    row: Integers
    face: Integers
    normal: Integers
    bodies: Integers
    head: Integers
    other: Integers
    arms: Floats
    lacking: Floats
    yielding: Floats
    friction: Floats
    held: Integers
    mode: Integers
    selected: Integers
    order: Integers
    seen: Integers
    least: Integers
    most: Integers
    unknowns: Integers
    place: Integers
    slope: Floats
    system: Floats
    pivot: Integers
    push: Floats
    gained: Floats
    impulse: Floats
    start: Floats
    trial: Floats
    best: Floats
    anchor: Floats
    motion: Floats
    solution: Floats
    line: Integers
    table: Floats
    basis: Integers
    outside: Integers
    tally: Integers


BANDED: Final = 1 << 22
"""Most entries of a banded system: one of 3,000 unknowns may couple those 466 apart."""
PIVOTED: Final = 600
"""Most rows of Lemke's method, which takes time like their cube."""


def make_impulse_workspace(pairs: int, bodies: int) -> ImpulseWorkspace:
    """Allocate the workspace of islands of at most so many pairs; pages that no island reaches cost nothing."""
    size, rows = 3 * pairs, min(5 * pairs, PIVOTED)

    def integers(*shape: int) -> Integers:
        return np.zeros(shape, dtype=np.int64)

    return ImpulseWorkspace(
        leader=integers(bodies),
        until=integers(bodies),
        island=integers(bodies),
        row=integers(2 * pairs),
        face=integers(2 * pairs),
        normal=integers(pairs + 1),
        bodies=integers(pairs, 2),
        head=integers(bodies),
        other=integers(2 * pairs),
        arms=np.zeros((size, 6)),
        lacking=np.zeros(size),
        yielding=np.zeros(size),
        friction=np.zeros(pairs),
        held=integers(pairs),
        mode=integers(size),
        selected=integers(size),
        order=integers(pairs),
        seen=integers(pairs),
        least=integers(pairs),
        most=integers(pairs),
        unknowns=integers(size),
        place=integers(size),
        slope=np.zeros(pairs),
        system=np.zeros(min(3 * size * size, BANDED)),
        pivot=integers(size),
        push=np.zeros(pairs),
        gained=np.zeros((bodies, 3)),
        impulse=np.zeros(size),
        start=np.zeros(size),
        trial=np.zeros(size),
        best=np.zeros(size),
        anchor=np.zeros(size),
        motion=np.zeros(size),
        solution=np.zeros(size),
        line=integers(rows, 2),
        table=np.zeros((rows, rows + 3)),
        basis=integers(rows),
        outside=integers(rows + 1),
        tally=integers(to.TALLY_SIZE),
    )


class ContactWorkspace(NamedTuple):
    """Workspace of the kernels for one group; see ``plant.kernels.contact.layout``.

    Attributes:
        rows: contact points of pairs, ``(2 k, ROW_SIZE)``.
        ends: bodies and pair of each contact point, ``(2 k, 3)``.
        marks: marks of pairs that stay together, ``(k,)``.
        held: marks of pairs held by friction, ``(k,)``.
        opens: opening speeds of pairs, ``(k,)``.
        pushed: impulses of each pair in the last step, two along the normal and one across, ``(3 k,)``.
        shifted: the same of the last problem of places or of an impact, ``(3 k,)``.
        first: ``(b, 3)``.
        second: ``(b, 3)``.
        third: ``(b, 3)``.
        left: what was left unsolved, ``(LEFT_SIZE,)``.
        impulses: workspace of the contact problems.
    """

    rows: Floats
    ends: Integers
    marks: Integers
    held: Integers
    opens: Floats
    pushed: Floats
    shifted: Floats
    first: Floats
    second: Floats
    third: Floats
    left: Floats
    impulses: ImpulseWorkspace


def make_workspace(group: Group) -> ContactWorkspace:
    """Allocate the workspace of a group."""
    pairs, bodies = len(group.pairs), len(group.names)
    return ContactWorkspace(
        np.zeros((2 * pairs, to.ROW_SIZE)),
        np.zeros((2 * pairs, 3), dtype=np.int64),
        np.zeros(pairs, dtype=np.int64),
        np.zeros(pairs, dtype=np.int64),
        np.zeros(pairs),
        np.zeros(3 * pairs),
        shifted=np.zeros(3 * pairs),
        first=np.zeros((bodies, 3)),
        second=np.zeros((bodies, 3)),
        third=np.zeros((bodies, 3)),
        left=np.zeros(to.LEFT_SIZE),
        impulses=make_impulse_workspace(pairs, bodies),
    )


@final
class Bodies:
    """All parcels and rails of a scene.

    Args:
        parcels: mass and inertia of each.
        bodies: the same as the solver holds them.
        rails: points of each, m.
        traction: the law, which bounds what parcels can do.
        gravity: m/s².
        drag: of the rollers, s/m.
        pitch: of the array, m.
        slow: m/s: what closes no faster doesn't bounce.

    Attributes:
        parcels: how many; the rails are numbered after them.
        radius: ``(b,)`` m, farthest corner of each.
        pull: ``(b, PULL_SIZE)``.
        rail_state: ``(r, 6)``: middle of each rail.
    """

    def __init__(
        self,
        parcels: Sequence[ParcelSpec],
        bodies: Sequence[Body],
        rails: Sequence[Sequence[tuple[float, float]]],
        traction: Traction,
        gravity: float,
        drag: float,
        pitch: float,
        slow: float,
    ) -> None:
        self._slow = slow
        self.parcels = len(parcels)
        points = [geometry.counter_clockwise(rail) for rail in rails]
        middle = [rail.mean(axis=0) for rail in points]
        self._outlines: list[Floats] = [
            *(body.footprint_m for body in bodies),
            *(rail - centre for rail, centre in zip(points, middle, strict=True)),
        ]
        self.rail_state: Floats = np.zeros((len(rails), 6))
        self.rail_state[:, :2] = np.array(middle).reshape(-1, 2)
        self.radius: Floats = np.array([np.hypot(*outline.T).max() for outline in self._outlines])
        mass = np.array([parcel.mass_kg for parcel in parcels])
        inertia = np.array([parcel.moment_of_inertia_kg_m2() for parcel in parcels])
        self._inverse = np.zeros((len(self._outlines), 2))
        self._inverse[: len(mass)] = np.stack([1.0 / mass, 1.0 / inertia], axis=1)
        self.pull: Floats = np.zeros((len(self._outlines), to.PULL_SIZE))
        reach = self.radius[: len(mass)]
        cells = (2.0 * reach / pitch + 2.0) ** 2
        self.pull[: len(mass)] = corner_pulls(traction, mass, inertia, reach, cells, gravity, drag)

    def states(self, parcels: Floats) -> Floats:
        """``(b, 6)`` states of all, from the parcels' ``(m, 6)``."""
        return np.concatenate([parcels, self.rail_state])

    def rail_distance(self, rail: int, places: Floats) -> Floats:
        """``(n,)`` how far points ``(n, 2)`` are from a rail's edges, m; ``rail`` is its number in the scene."""
        corners = self._outlines[rail] + self.rail_state[rail - self.parcels, :2]
        edges = np.roll(corners, -1, axis=0) - corners
        arms = places[:, None, :] - corners
        along = np.clip(np.sum(arms * edges, axis=2) / np.sum(edges * edges, axis=1), 0.0, 1.0)
        return np.min(np.hypot(*np.moveaxis(arms - along[:, :, None] * edges, 2, 0)), axis=1)

    def group(self, pairs: Integers, live: NDArray[np.bool_], states: Floats) -> Group:
        """The bodies of some pairs, by themselves.

        Args:
            pairs: ``(k, 2)`` numbers in the scene.
            live: ``(b,)`` which move.
            states: ``(b, 6)``.
        """
        names, places = np.unique(pairs, return_inverse=True)
        moving = live[names]
        still = states[names]
        still[:, 3:] = 0.0
        return Group(
            names,
            np.flatnonzero(moving),
            np.sort(places.reshape(-1, 2), axis=1).astype(np.int64),
            pack([self._outlines[int(i)] for i in names]),
            self._inverse[names] * moving[:, None],
            self.pull[names],
            still,
            self._slow,
        )
