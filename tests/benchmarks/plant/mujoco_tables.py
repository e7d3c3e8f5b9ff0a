"""The smaller tables of the page on MuJoCo: creep, loads, the nearest to viscous traction, and many cells."""

from __future__ import annotations

import statistics

import numpy as np
from mujoco_model import CONTACTS, COULOMB, MU, SAMPLE_S, Contact, run, speeds_of

from deploy.studies.accuracy.experiments.markdown import error, milliseconds, table
from deploy.studies.accuracy.experiments.runs import ExperimentTrace, max_displacement_m, scene_with
from deploy.studies.accuracy.experiments.runs import run as run_ours
from plant.analysis.constants import constants_of_motion
from plant.array import CellArray
from plant.plant import Plant


def held_table() -> str:
    """A parcel for 10 s on wheels that stand, but for a row that turns: how far it gets, which should be nowhere."""
    scene = scene_with(
        "coulomb",
        "parcels.0.position_m=[0.0, 0.0]",
        "parcels.0.angular_velocity_rad_s=0.0",
        "duration_s=10.0",
    )
    speeds = np.zeros_like(speeds_of(scene))
    speeds[CellArray(scene.array).lattice.rows == 5, 0] = 0.2
    lines: list[list[str]] = []
    for contact in CONTACTS:
        for step in (2e-3, 5e-4):
            one = run(scene, speeds, MU, step, contact, scene.duration_s)
            end = one.state[-1] - one.state[0]
            lines.append(
                [
                    f"MuJoCo, {contact.title}",
                    f"{step * 1e3:g} ms",
                    "failed" if one.failed else error(float(np.hypot(end[0], end[1]))),
                    "–" if one.failed else error(abs(float(end[2]))),
                ]
            )
    plant = Plant(scene.plant_spec())
    start = plant.state[0]
    plant.advance(speeds, scene.duration_ns)
    moved = np.abs(plant.state[0] - start)
    lines.append(["`implicit`", "tolerance 1e-7", error(float(np.hypot(*moved[:2]))), error(float(moved[2]))])
    return table(["model", "step", "moved, m", "turned, rad"], lines)


def loads_table() -> str:
    """Normal forces where the parcel of ``elliptic`` starts, beside those of equal springs."""
    scene = scene_with("elliptic")
    known = constants_of_motion(scene.plant_spec(), 0, speeds_of(scene))
    cells = [CellArray(scene.array).lattice.index(cell) for cell in known.supports]
    lines: list[list[str]] = []
    for contact in CONTACTS:
        one = run(scene, speeds_of(scene), MU, 5e-4, contact, SAMPLE_S, cells=len(cells))
        off = np.abs(one.loads_n[cells] - known.loads_n).max() / known.loads_n.mean()
        lines.append([f"MuJoCo, {contact.title}", str(int((one.loads_n > 0.0).sum())), error(float(off))])
    lines.append(["plant", str(len(cells)), "–"])
    return table(["model", "cells that carry", "largest difference / mean load"], lines)


def viscous_table() -> str:
    """The scene ``elliptic`` as it is, with a damper in each contact: the same for all cells, not by load."""
    scene = scene_with("elliptic", "duration_s=3.0")
    known = run_ours(scene, {"name": "exact", "tolerance": 1e-12}, sample_s=SAMPLE_S)
    mass, cells = scene.parcels[0].mass_kg, 17
    drag = 0.2 * mass * scene.gravity_m_s2 / cells  # mu W, in equal parts
    lines: list[list[str]] = []
    for step in (1e-3, 5e-4):
        contact = Contact(
            "", cone="elliptic", radius_m=1e-3, sag_m=1e-4, slip_per_s=drag * (1.0 - 1e-4) / 1e-4 / mass
        )
        one = run(scene, speeds_of(scene), 100.0, step, contact, 3.0, cells)
        state = np.zeros_like(known.state)
        state[:, :3] = one.state
        off = float(
            max_displacement_m(
                ExperimentTrace(known.time_s, state, known.footprint_m, (), 0, 0.0), known
            ).max()
        )
        lines.append(
            [
                "MuJoCo, springs and equal dampers",
                f"{step * 1e3:g} ms",
                error(off),
                milliseconds(one.spent_s),
            ]
        )
    spent = milliseconds(known.spent_s / scene.duration_s)
    lines.append(["`exact`", "tolerance 1e-12", "–", spent])
    return table(["model", "step", "error, m", "time"], lines)


def cells_table(repeats: int) -> str:
    """What a simulated second takes on larger arrays, the parcel being the same."""
    lines: list[list[str]] = []
    for side in (12, 20, 28):
        scene = scene_with(
            "elliptic", *COULOMB, f"array.rows={side}", f"array.columns={side}",
            "parcels.0.position_m=[0.2, 0.2]", "duration_s=1.0",
        )  # fmt: skip
        speeds = speeds_of(scene)
        spent = [
            statistics.median(run(scene, speeds, MU, 1e-3, contact, 1.0).spent_s for _ in range(repeats))
            for contact in (CONTACTS[0], CONTACTS[-1])
        ]
        spent += [
            run_ours(scene, {"name": "implicit", **settings}, sample_s=SAMPLE_S, repeats=repeats).spent_s
            for settings in ({"step_s": 1e-3}, {"tolerance": 1e-5})
        ]
        lines.append([f"{side**2}", *(milliseconds(one) for one in spent)])
    heading = ["cells", "MuJoCo, as it comes, 1 ms", "MuJoCo, springs, 1 ms"]
    return table([*heading, "`implicit`, 1 ms", "`implicit`, tolerance 1e-5"], lines)
