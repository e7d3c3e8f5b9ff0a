"""The closed form of a parcel's way in a linear field, against a matrix exponential and the plant."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.commands.options import load_scene
from deploy.runs.field_simulation import field_speeds, without_cells
from deploy.studies.accuracy.closed_form import closed_form, oscillation
from deploy.studies.accuracy.trace import run_trace
from plant.analysis.equilibrium import LinearField
from plant.array import CellArray

TIMES = np.linspace(0.0, 3.0, 7)
DAMPING = 1.962


@pytest.mark.parametrize(
    "rate",
    [
        [[-1.0, 0.0], [0.0, -2.0]],
        [[-0.3, 1.0], [-1.0, -0.3]],
        [[-DAMPING / 4.0, 0.0], [0.0, -1.0]],
        [[0.5, 0.2], [0.1, -0.4]],
    ],
    ids=["elliptic", "a spiral", "critical damping", "a saddle"],
)
def test_it_is_the_matrix_exponential_of_the_oscillator(rate: list[list[float]]) -> None:
    expm = pytest.importorskip("scipy.linalg").expm
    field = LinearField(np.array(rate), np.array([0.1, -0.2]))
    starts = np.array([[0.5, 0.4, 0.9, 0.1, -0.2, 3.0], [-0.2, 0.3, 0.0, 0.0, 0.0, 0.0]])
    found = oscillation(field, DAMPING, starts, TIMES)
    assert found is not None
    system = np.zeros((5, 5))
    system[:2, 2:4] = np.eye(2)
    system[2:4] = np.concatenate(
        [DAMPING * field.rate_per_s, -DAMPING * np.eye(2), DAMPING * field.offset_m_s[:, None]], axis=1
    )
    for k, time_s in enumerate(TIMES):
        for i, start in enumerate(starts):
            known = expm(system * time_s) @ [*start[:2], *start[3:5], 1.0]
            assert found[k, i] == pytest.approx(known[:2], abs=1e-13)


def test_a_field_with_one_direction_only_has_none() -> None:
    shear = LinearField(np.array([[-1.0, 1.0], [0.0, -1.0]]), np.zeros(2))
    assert oscillation(shear, DAMPING, np.zeros((1, 6)), TIMES) is None


def test_the_plant_follows_it_through_its_support_changes() -> None:
    scene = without_cells(load_scene("elliptic", duration=1.0))
    trace = run_trace(scene)
    assert sum(event.kind.startswith("support") for event in trace.events) > 20
    speeds = field_speeds(scene, CellArray(scene.array).positions_m)
    known = closed_form(scene, speeds, trace.state[0], trace.time_s)
    assert known is not None
    assert trace.state[..., :2] == pytest.approx(known, abs=1e-11)


@pytest.mark.parametrize(
    "change",
    [
        "faults=[{at_s=0.1,cell=[3,4],kind='crash'}]",
        "effects.contact_width={width_m=0.01}",
        "friction={law='stick_slip',coefficient=0.2,motor_constant_n_per_a=1.0,resistance_ohm=4.0,gain_v_s_per_m=1.0}",
        "cells.parameters.field={kind='radial',speed_m_s=0.1}",
    ],
)
def test_where_it_does_not_hold_there_is_none(change: str) -> None:
    solver = "implicit"
    scene = load_scene("elliptic", [change], solver=solver, tolerance=1e-6)
    speeds = field_speeds(scene, CellArray(scene.array).positions_m)
    assert closed_form(scene, speeds, np.zeros((1, 6)), TIMES) is None
