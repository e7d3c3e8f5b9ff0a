"""Compilation of a scene's kernels ahead of its runs."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import numpy as np

from deploy.runs.compilation import compilation_reported
from deploy.runs.setup import load_plant
from deploy.scenes.scene import Scene
from deploy.util.formatting import silent
from deploy.workers.worker import compile_program, kernels_of

if TYPE_CHECKING:
    from plant.plant import Plant
    from plant.specs import PlantSpec

_TOUCHING: Final = (
    {"size_m": (0.25, 0.25), "mass_kg": 1.0, "position_m": (-0.1251, 0.0), "velocity_m_s": (0.5, 0.0)},
    {"size_m": (0.25, 0.25), "mass_kg": 1.0, "position_m": (0.1251, 0.0)},
)
"""Two parcels, the first about to strike the second and to stay with it."""

_CONTACT_TICKS: Final = 10
"""Until both have happened, of 1 ms each."""


def compile_scene(scene: Scene, say: Callable[[str], None]) -> int:
    """Compile, or load, the kernels of a scene's runs. Returns how many entry points were compiled.

    Args:
        scene: the scene.
        say: called with progress as long as something is compiled.

    Raises:
        InputError: The plant refuses the scene.
    """
    with compilation_reported(scene.solver.name, say) as entries:
        for module in dict.fromkeys((*kernels_of(scene), *kernels_of(scene, live=True))):
            importlib.import_module(module)
        compile_program(scene)
        plant = load_plant(scene, silent)
        _advance(plant, 1)
        if scene.effects.parcel_contact is not None:
            from plant.plant import Plant

            _advance(Plant(_touching(scene.plant_spec())), _CONTACT_TICKS)
    return entries()


def _touching(spec: PlantSpec) -> PlantSpec:
    """Two parcels that touch, with the scene's solver and law: kernels of contact run only then."""
    from plant.specs import PlantSpec

    return PlantSpec.model_validate(
        {
            "array": {"rows": 4, "columns": 8, "pitch_m": 0.1},
            "parcels": _TOUCHING,
            "friction": spec.friction.model_dump(),
            "solver": spec.solver.model_dump(),
            "effects": {"parcel_contact": {}},
        }
    )


def _advance(plant: Plant, ticks: int) -> None:
    """Advance with wheels at rest."""
    drives = np.zeros((len(plant.array), 2))
    for _ in range(ticks):
        plant.advance(drives, plant.time_ns + 1_000_000)
