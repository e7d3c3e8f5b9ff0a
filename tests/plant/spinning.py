"""Random scenes of parcels that spin, and how far one solver is from another on them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from plant.friction.registry import FrictionSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import ROLLING, STICK_SLIP, VISCOUS
from tests.plant.scenes import SECOND, Floats, parcel, spec

SCENES = 200
"""The whole sample."""
SPAN_S = 1.0
TOLERANCES = tuple(float(f"1e-{k}") for k in range(4, 11))
LAWS: dict[str, FrictionSpec] = {"viscous": VISCOUS, "rolling": ROLLING, "stick_slip": STICK_SLIP}
CAPTURE = 0.1
"""``capture_m`` of both solvers over the tolerance."""
REFERENCE = 1e-3
"""Tolerance of the reference over the one in question, ..."""
FINEST = 1e-13
"""... which isn't smaller than this, m."""
NEIGHBOURS = 3
"""Starts beside a scene's own, a tolerance away, from which it is begun to see how far that leads."""
SENSITIVE = 10.0
"""Scenes in which that is more than so many tolerances say nothing of a solver."""
HOLES = tuple(cell for cell in product(range(24), repeat=2) if (3 * cell[0] + 5 * cell[1]) % 11 == 0)


@dataclass(frozen=True)
class Scene:
    """One parcel that spins in a random field.

    Attributes:
        seed: names the scene.
        law: name of its law, of ``LAWS``.
        tolerance: in question, m.
        body: the parcel's settings.
        holes: cells that are missing.
    """

    seed: int
    law: str
    tolerance: float
    body: dict[str, Any]
    holes: tuple[tuple[int, int], ...]

    def plant(self, solver: dict[str, Any], start: Floats | None = None) -> tuple[Plant, Floats]:
        """The scene under a solver, and its wheels' speeds; from another start if one is given."""
        body = spec(parcel(**self.body), rows=24, columns=24, missing=self.holes)
        plant = Plant(
            PlantSpec.model_validate(dict(body) | {"friction": LAWS[self.law], "solver": dict(solver)})
        )
        if start is not None:
            plant._solver.set_state(0, start)
        draw = np.random.default_rng([self.seed, 1])
        stretch, turn = draw.uniform(-2.0, 0.5, 2), draw.uniform(-1.5, 1.5)
        places = plant.array.positions_m
        drives = places * stretch + turn * np.stack([-places[:, 1], places[:, 0]], axis=1)
        return plant, drives + draw.uniform(0.0, 0.2) * draw.standard_normal(places.shape)


def scene(seed: int) -> Scene:
    """The scene of a seed: laws and tolerances in turn, spins of up to 30 rad/s, holes in some arrays."""
    draw = np.random.default_rng([seed, 0])
    body = {
        "size_m": tuple(draw.uniform(0.25, 0.6, 2)),
        "position_m": tuple(draw.uniform(-0.25, 0.25, 2)),
        "angle_rad": draw.uniform(0.0, 6.0),
        "velocity_m_s": tuple(draw.uniform(-0.3, 0.3, 2)),
        "angular_velocity_rad_s": draw.choice([-1.0, 1.0]) * draw.uniform(0.0, 30.0),
        "centre_of_mass_m": tuple(draw.uniform(-0.05, 0.05, 2) * draw.integers(2)),
    }
    names = tuple(LAWS)
    return Scene(
        seed,
        names[seed % len(names)],
        TOLERANCES[seed // len(names) % len(TOLERANCES)],
        body,
        HOLES if draw.random() < 0.3 else (),
    )


def end(one: Scene, solver: dict[str, Any], start: Floats | None = None) -> Floats:
    """State ``(6,)`` of the scene's parcel at its end."""
    plant, drives = one.plant(solver, start)
    plant.advance(drives, round(SPAN_S * SECOND))
    return plant.state[0]


def off_m(one: Scene, first: Floats, second: Floats) -> float:
    """How far apart two poses are at the footprint, m."""
    size = np.asarray(one.body["size_m"])
    radius = 0.5 * float(np.hypot(*size)) + float(np.hypot(*one.body["centre_of_mass_m"]))
    return float(np.hypot(*(first - second)[:2]) + radius * abs(first[2] - second[2]))


@dataclass(frozen=True)
class Outcome:
    """How far a solver is off in a scene.

    Attributes:
        scene: which.
        off: how far ``implicit`` is from ``exact``, over the tolerance.
        moves: how far the exact end moves where the start moves by one tolerance, over the tolerance.
    """

    scene: Scene
    off: float
    moves: float

    @property
    def sensitive(self) -> bool:
        """Whether the scene says nothing of a solver."""
        return self.moves > SENSITIVE


def measure(one: Scene, solver: dict[str, Any] | None = None) -> Outcome:
    """Put a scene to ``implicit``, or the solver given, and to ``exact``."""
    capture_m, fine = CAPTURE * one.tolerance, max(REFERENCE * one.tolerance, FINEST)
    exact = {"name": "exact", "tolerance": fine, "capture_m": capture_m}
    known = end(one, exact)
    found = end(one, solver or {"name": "implicit", "tolerance": one.tolerance, "capture_m": capture_m})
    plant, _ = one.plant(exact)
    start, draw = plant.state[0].copy(), np.random.default_rng([one.seed, 2])
    moves = 0.0
    for _ in range(NEIGHBOURS):
        aside = draw.standard_normal(3)
        aside *= one.tolerance / np.abs(aside).max()
        beside = start.copy()
        beside[:2] += aside[:2]
        beside[2] += aside[2] / 0.3
        moves = max(moves, off_m(one, end(one, exact, beside), known))
    return Outcome(one, off_m(one, found, known) / one.tolerance, moves / one.tolerance)
