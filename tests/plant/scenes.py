"""Scenes for the plant, and looks inside it that several tests need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from plant.effects.motors import MotorsSpec
from plant.effects.registry import PlantEffects
from plant.friction.registry import FrictionSpec
from plant.friction.viscous import Viscous
from plant.kernels.common import layout
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ExactSpec
from plant.solvers.restarting import RestartingSolver
from plant.specs import PlantSpec
from tests.plant.reference import Bench

Floats = NDArray[np.float64]
SECOND = 1_000_000_000
TICK_NS = 4_096_000
G = 9.81
MU = 0.2


def parcel(**values: object) -> ParcelSpec:
    """The parcel of the study scene, with what is given instead."""
    settings: dict[str, object] = {"mass_kg": 2.0, "position_m": (0.55, 0.5), "angle_rad": 0.9}
    if "vertices_m" not in values:
        settings["size_m"] = (0.54, 0.32)
    return ParcelSpec.model_validate(settings | values)


def spec(
    *parcels: ParcelSpec,
    rows: int = 20,
    columns: int = 20,
    pitch_m: float = 0.1,
    mu: float = MU,
    tolerance: float = 1e-12,
    capture_m: float = 1e-6,
    motors: MotorsSpec | None = None,
    **array: object,
) -> PlantSpec:
    """A plant on a 20 x 20 array unless said otherwise."""
    return PlantSpec(
        array=ArraySpec.model_validate({"rows": rows, "columns": columns, "pitch_m": pitch_m} | array),
        parcels=parcels,
        friction=Viscous(coefficient_s_per_m=mu),
        effects=PlantEffects(motors=motors),
        solver=ExactSpec(tolerance=tolerance, capture_m=capture_m),
    )


def elliptic(plant: Plant, kx: float = -1.0, ky: float = -2.0) -> Floats:
    """Wheel speeds of the field ``(kx x, ky y)``."""
    return plant.array.positions_m * (kx, ky)


def study(**values: object) -> Plant:
    """The scene of the published event times."""
    return Plant(spec(parcel(), **values))  # type: ignore[arg-type]


def bench(plant: Plant, drives: Floats, index: int = 0, mu: float = MU, **settings: object) -> Bench:
    """The reference plant for one parcel of ``plant`` under viscous friction ``mu``."""
    constants = plant._solver.parcels[index].par
    return Bench(
        cells=plant.array.positions_m,
        steady=drives,
        corners=plant.footprints_m[index],
        kappa=mu * G,
        mass_over_inertia=float(constants[layout.MASS_OVER_INERTIA]),
        **settings,  # type: ignore[arg-type]
    )


def members(plant: Plant, index: int = 0) -> NDArray[np.int64]:
    """Cells that the plant takes to lie under a parcel."""
    return np.sort(plant._solver.covered_cells(index))


def loads(plant: Plant) -> tuple[NDArray[np.int64], Floats]:
    """Cells under the parcel of a plant of one parcel, and the share of its weight on each, as the solver has them."""
    solver, place = plant._solver, plant.state[0, :2]
    if isinstance(solver, RestartingSolver):
        (moving,) = solver._parcels
        supports = moving.supports
        assert supports is not None
        share = supports.plane @ np.array([1.0, *(place - supports.centroid_m)])
        return moving.under, np.where(supports.carrying, share, 0.0)
    inner, work = solver.parcels[0], solver.workspace(0).work
    work = getattr(work, "pulls", work)
    seg = work.segs[0] if hasattr(work, "segs") else work.seg
    listed = inner.mem[: inner.ctl[layout.N_MEMBERS]]
    offset = plant.array.positions_m[listed[:, layout.CELL]] - place - seg[[layout.CX, layout.CY]]
    inverse = np.array([[seg[layout.PXX], seg[layout.PXY]], [seg[layout.PXY], seg[layout.PYY]]])
    share = 1.0 / seg[layout.N_ACTIVE] + offset @ inverse @ -seg[[layout.CX, layout.CY]]
    share[listed[:, layout.MARK] != layout.ACTIVE] = 0.0
    return listed[:, layout.CELL].astype(np.int64), share


def turned(points: Floats, angle: float) -> Floats:
    """Points ``(n, 2)`` turned about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def cells_of(plant: Plant, cells: Sequence[tuple[int, int]]) -> list[int]:
    """Indices of cells named by row and column."""
    return [plant.array.lattice.index(cell) for cell in cells]


def solved(
    solver: dict[str, object],
    *parcels: ParcelSpec,
    law: FrictionSpec | None = None,
    effects: Mapping[str, object] | None = None,
    **values: object,
) -> Plant:
    """A plant of `spec` with a scene's ``[solver]`` table, and another law or ``[effects]`` where they are given."""
    base = dict(spec(*(parcels or (parcel(),)), **values))  # type: ignore[arg-type]
    base["solver"] = solver
    if law is not None:
        base["friction"] = law
    if effects is not None:
        base["effects"] = dict(effects)
    return Plant(PlantSpec.model_validate(base))


def lawful(
    law: FrictionSpec,
    *parcels: ParcelSpec,
    tolerance: float = 1e-8,
    step_s: float | None = None,
    **values: object,
) -> Plant:
    """A plant under any law, integrated by ``implicit``."""
    solver: dict[str, object] = {"name": "implicit", "tolerance": tolerance, "step_s": step_s}
    return solved(solver, *parcels, law=law, **values)
