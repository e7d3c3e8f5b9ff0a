"""What sampling costs the whole system: time with ideal wheels, and accuracy with motors."""

from __future__ import annotations

from deploy.commands.options import load_scene
from deploy.runs.field_simulation import without_cells
from deploy.studies.accuracy.report import Sampling
from deploy.studies.accuracy.sampling_cost import sampling_cost
from deploy.studies.accuracy.trace import run_trace


def price(*changes: str) -> list[Sampling]:
    array = ("array.rows=12", "array.columns=12", "parcels.0.position_m=[0.1,0.2]")
    scene = load_scene("elliptic", [*array, *changes], duration=0.32768)
    reference = run_trace(without_cells(scene))
    return sampling_cost(scene, reference, quick=True, limit_s=60.0, poll=lambda: None)


def test_with_ideal_wheels_cells_and_bus_change_nothing_at_any_period() -> None:
    (found,) = price("solver.tolerance=1e-12")
    assert [row.period_s for row in found.rows] == [0.032768, 0.016384, 0.008192, 0.004096]
    assert all(row.status == "ok" and (row.error_max or 0.0) < 1e-11 for row in found.rows)
    assert found.wheels == "ideal wheels"


def test_with_motors_errors_fall_with_the_period_and_the_shortest_is_what_they_are_from() -> None:
    (found,) = price("effects.motors={}", "cells.period_s=0.001024")
    errors = [row.error_max for row in found.rows]
    assert errors[-1] is None
    assert found.against == "the run at 1.024 ms"
    judged = [error or 0.0 for error in errors[:-1]]
    assert judged[0] > 1.5 * judged[1] > 2.25 * judged[2] > 0.0


def test_clocks_of_cells_are_left_out() -> None:
    """With them, ticks would not end together at every period."""
    (plain,) = price("effects.motors={}")
    (found,) = price("effects.motors={}", "effects.clock={ error_ppm = 20_000 }")
    assert [row.error_max for row in found.rows] == [row.error_max for row in plain.rows]


def test_after_a_run_that_takes_too_long_no_shorter_period_is_tried() -> None:
    scene = load_scene("elliptic", duration=0.065536)
    reference = run_trace(without_cells(scene))
    (found,) = sampling_cost(scene, reference, quick=True, limit_s=0.0, poll=lambda: None)
    assert [row.status for row in found.rows] == ["ok", "omitted", "omitted", "omitted"]
    assert all("the run at 0.032768 s took" in (row.reason or "") for row in found.rows[1:])
