"""What can touch: parcels and rails; and those of them that may do so within a span, by themselves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.contact.bounds import corner_pulls
from plant.contact.shapes import Shapes, pack
from plant.friction.law import Traction
from plant.kernels import contact_layout as to
from plant.solvers.solver import Body
from plant.specs import ParcelSpec

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Group(NamedTuple):
    """Bodies that may touch, numbered from 0 among themselves.

    Attributes:
        names: ``(b,)`` their numbers in the scene: parcels, then rails.
        moving: ``(g,)`` those that move, ascending; the others stand.
        pairs: ``(k, 2)`` those that may touch, the lesser first.
        shapes: outlines.
        inverse: ``(b, 2)`` one over mass, 1/kg, and over moment of inertia, 1/(kg m²); 0 for what stands.
        pull: ``(b, PULL_SIZE)``: see ``plant.kernels.meetings``.
        still: ``(b, 6)`` states of those that stand.
        slow: m/s: what closes no faster doesn't bounce.
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
        """``(g,)`` numbers of those that move."""
        return self.names[self.moving]

    def stopped(self, body: int, state: Floats) -> Group:
        """The same with a body that stands from now on."""
        inverse, still = self.inverse.copy(), self.still.copy()
        inverse[body] = 0.0
        still[body, :3] = state[:3]
        return self._replace(moving=self.moving[self.moving != body], inverse=inverse, still=still)


class Work(NamedTuple):
    """Scratch of the kernels for one group; see ``plant.kernels.contact_layout``.

    Attributes:
        rows: ``(2 k, ROW_SIZE)`` points at which pairs touch.
        ends: ``(2 k, 3)`` whose they are.
        marks: ``(k,)`` of the pairs: which stay together.
        held: ``(k,)`` likewise: which friction holds.
        opens: ``(k,)`` how fast they open.
        first: ``(b, 3)``.
        second: likewise.
        third: likewise.
    """

    rows: Floats
    ends: Integers
    marks: Integers
    held: Integers
    opens: Floats
    first: Floats
    second: Floats
    third: Floats


def make_work(group: Group) -> Work:
    """Scratch for a group."""
    pairs, bodies = len(group.pairs), len(group.names)
    return Work(
        np.zeros((2 * pairs, to.ROW_SIZE)),
        np.zeros((2 * pairs, 3), dtype=np.int64),
        np.zeros(pairs, dtype=np.int64),
        np.zeros(pairs, dtype=np.int64),
        np.zeros(pairs),
        *np.zeros((3, bodies, 3)),
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
        self.pull[: len(mass)] = corner_pulls(traction, mass, inertia, reach, cells, gravity)

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
