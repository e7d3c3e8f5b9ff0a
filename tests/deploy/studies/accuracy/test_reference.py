"""What solvers are judged by agrees with other methods, and says which it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from deploy.commands.options import load_scene
from deploy.runs.field_simulation import without_cells
from deploy.scenes.scene import Scene
from deploy.studies.accuracy.errors import displacement_m
from deploy.studies.accuracy.reference import METHODS, ReferenceSolver
from deploy.studies.accuracy.sweep import with_solver
from deploy.studies.accuracy.trace import run_trace
from plant.solvers import restarting as restarted

IMPLICIT = {"name": "implicit", "tolerance": 1e-11, "capture_m": 1e-12}
CHATTERS = ("parcels.0.size_m=[0.4,0.42]", "parcels.0.position_m=[0.0,0.0]", "parcels.0.angle_rad=1.125")
"""The scene of ever shorter swings, begun where they are."""


def random_scenes(count: int, duration_s: float) -> list[Scene]:
    """Scenes with sizes, starts, velocities and fields of their own."""
    draw = np.random.default_rng(2026)
    scenes: list[Scene] = []
    for _ in range(count):
        (length, width), (x, y), angle = (
            draw.uniform(0.25, 0.6, 2),
            draw.uniform(-0.4, 0.4, 2),
            draw.uniform(0, 6),
        )
        kx, ky = draw.uniform(-2.5, -0.5, 2)
        vx, vy = draw.uniform(-0.4, 0.4, 2)
        changes = [
            f"parcels.0.size_m=[{length},{width}]",
            f"parcels.0.position_m=[{x},{y}]",
            f"parcels.0.angle_rad={angle}",
            f"parcels.0.velocity_m_s=[{vx},{vy}]",
            f"cells.parameters.field={{kind='elliptic',kx_per_s={kx},ky_per_s={ky}}}",
        ]
        scenes.append(without_cells(load_scene("elliptic", changes, duration=duration_s)))
    return scenes


@pytest.mark.slow
def test_the_reference_without_heyoka_is_heyoka_s_to_1e_12_on_20_random_scenes() -> None:
    pytest.importorskip("heyoka")
    changes = 0
    for scene in random_scenes(20, 0.4096):
        reference = ReferenceSolver(scene, limit_s=60.0, methods=METHODS[1:], thorough=False).solve()
        assert reference.solver == "scipy"
        known = run_trace(with_solver(scene, METHODS[0]))
        until = reference.trace.samples_until(reference.duration_s)
        assert until > 90
        off = displacement_m(reference.trace.state[:until], known.state[:until], known.footprints_m)
        assert off.max() < 1e-12
        changes += len(known.events)
    assert changes > 200


def test_the_reference_of_the_core_is_exact_s_to_1e_12() -> None:
    for scene in random_scenes(4, 0.4096):
        reference = ReferenceSolver(scene, limit_s=60.0, methods=METHODS[2:]).solve()
        assert reference.method == "implicit, tolerance 1e-11, capture_m 1e-12"
        by = {one.method: one for one in reference.agreement}
        assert set(by) == {"closed form", "exact, tolerance 1e-14"}
        assert max(one.apart_m for one in reference.agreement) < 1e-12


def test_the_solver_of_the_reference_is_judged_by_another() -> None:
    scene = without_cells(load_scene("elliptic", duration=0.2))
    reference = ReferenceSolver(scene, limit_s=60.0, methods=[IMPLICIT]).solve()
    assert reference.judge("implicit")[0] == "exact"
    assert reference.judge("exact") == ("implicit", reference.trace)


def test_where_no_other_method_is_to_be_had_exact_is_judged_by_itself_and_that_is_said() -> None:
    scene = without_cells(load_scene("elliptic", duration=0.2))
    reference = ReferenceSolver(scene, limit_s=60.0, methods=[]).solve()
    assert reference.solver == "exact"
    assert "exact is judged against itself, finer." in " ".join(reference.notes)
    assert [one.method for one in reference.agreement] == ["closed form"]


def test_a_law_that_one_solver_has_is_checked_by_a_crude_one_and_that_is_said() -> None:
    scene = load_scene("coulomb", duration=0.1)
    reference = ReferenceSolver(scene, limit_s=60.0, methods=[IMPLICIT]).solve()
    assert [one.method.split(",")[0] for one in reference.agreement] == ["fixed_step"]
    assert 0.0 < reference.agreement[0].apart_m < 1e-3
    assert "implicit is judged against itself, finer" in " ".join(reference.notes)


def test_events_are_compared_before_chatter_and_its_end_by_every_crossing_located() -> None:
    scene = without_cells(load_scene("elliptic", list(CHATTERS), duration=3.0))
    method = {"name": "implicit", "tolerance": 1e-7, "capture_m": 1e-10}
    reference = ReferenceSolver(scene, limit_s=60.0, methods=[method]).solve()
    assert reference.chatter_s is not None
    first = next(e.time_s for e in run_trace(scene).events if e.kind == "captured")
    assert first - 0.02 < reference.chatter_s < first
    located = reference.agreement[-1]
    assert "capture_m" in located.method
    assert located.apart_m < 1e-7
    assert located.until_s == 3.0


def test_a_method_that_chatter_stops_is_the_reference_up_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("scipy")
    monkeypatch.setattr(restarted, "CHANGES_PER_SECOND", 30)
    monkeypatch.setattr(restarted, "CHANGES_PER_MEMBER", 0)
    scene = without_cells(load_scene("elliptic", list(CHATTERS), duration=3.0))
    method = {"name": "scipy", "method": "DOP853", "tolerance": 1e-8}
    reference = ReferenceSolver(scene, limit_s=60.0, methods=[method]).solve()
    assert reference.solver == "scipy"
    assert any("the reference is not scipy but exact" in note for note in reference.notes)
    exact = run_trace(with_solver(scene, {"name": "exact", "tolerance": 1e-14, "capture_m": 1e-12}))
    assert np.array_equal(reference.trace.state[-1], exact.state[-1])
    assert not np.array_equal(reference.trace.state[20], exact.state[20])


def test_a_run_that_takes_too_long_is_stopped_and_said_so() -> None:
    scene = without_cells(load_scene("elliptic"))
    trace = run_trace(with_solver(scene, {"name": "fixed_step", "step_s": 1e-4}), limit_s=1e-9)
    assert trace.status == "stopped"
    assert trace.reason is not None
    assert trace.reason.startswith("took longer than 1e-09 s")
    assert dataclasses.replace(trace, reason=None).time_s.tolist() == [0.0]
