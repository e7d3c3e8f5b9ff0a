"""The solvers that the hard cases are put to, each as a scene would ask for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from plant.kernels import layout
from plant.plant import Plant
from plant.specs import ParcelSpec, PlantSpec
from tests.plant.scenes import spec


@dataclass(frozen=True)
class Solver:
    """A solver under test.

    Attributes:
        settings: A scene's ``[solver]`` table, at the solver's tightest.
        steps: How many steps a plant of one parcel has taken so far.
    """

    settings: dict[str, Any]
    steps: Callable[[Plant], int]

    def spec(self, *parcels: ParcelSpec, **scene: Any) -> PlantSpec:
        """A scene of ``tests.plant.scenes.spec`` for this solver; ``solver`` holds what is set otherwise."""
        settings = self.settings | scene.pop("solver", {})
        plain = spec(*parcels, **scene)
        return PlantSpec.model_validate(plain.model_dump() | {"solver": settings})

    def plant(self, *parcels: ParcelSpec, **scene: Any) -> Plant:
        """A plant of the scene that ``spec`` describes."""
        return Plant(self.spec(*parcels, **scene))


SOLVERS = {
    "exact": Solver(
        settings={"name": "exact", "tolerance": 1e-12, "capture_m": 1e-6},
        steps=lambda plant: int(plant._solver.parcels[0].ctl[layout.N_STEPS]),
    ),
}
"""Every hard case runs with every one of them. A new solver is one entry."""
