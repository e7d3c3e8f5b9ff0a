"""Nothing that a run carries from tick to tick is forgotten: whatever the scene, going back changes nothing."""

from __future__ import annotations

import pytest

from bus.errors import StateError
from bus.state import load_state
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from tests.deploy.checkpoints.alike import differences
from tests.deploy.checkpoints.direct import DirectRun

BEFORE, AFTER = 24, 24
"""Ticks until what is remembered is taken, and from then on."""

CASES: dict[str, tuple[str, dict[str, object]]] = {
    "all effects of sensors and links": ("noisy", {"effects.link_delay": {"between_ticks": (0, 3)}}),
    "links that all delay alike": ("heat", {"effects.link_delay": {"ticks": 3}}),
    "clocks and converters": ("drifting", {}),
    "serial lines": ("serial", {}),
    "a watchdog": ("watchdog", {}),
    "analogue sensors": ("spots", {}),
    "feeders and scanners": ("junction", {"duration_s": 1.0}),
    "parcels that touch": ("rails", {}),
    "wheels with rollers": ("bumpy", {}),
    "wheels that feel what they pull": ("loaded", {}),
    "wide wheels": ("wide_wheels", {}),
    "wheels that hold": (
        "coulomb",
        {"friction": {"law": "coulomb", "coefficient": 0.3, "static_coefficient": 0.45}},
    ),
    "uneven supports": ("uneven", {}),
    "tall parcels": ("tall", {}),
    "steps of one length": ("elliptic", {"solver": {"name": "fixed_step", "step_s": 1e-3}}),
    "somebody else's integrator": ("elliptic", {"solver": {"name": "scipy"}}),
    "cells that die": ("heat", {"faults": [{"at_s": 0.05, "cell": [2, 2]}, {"at_s": 0.12, "cell": [1, 1]}]}),
    "cells that die and come back": (
        "heat",
        {
            "faults": [
                {"at_s": 0.05, "until_s": 0.15, "share": 0.2},
                {"at_s": 0.02, "until_s": 0.08, "cell": [1, 1]},
            ]
        },
    ),
    "wheels and cells that faults act on": (
        "elliptic",
        {
            "faults": [
                {"kind": "wheel_stuck", "at_s": 0.02, "share": 0.1},
                {"kind": "wheel_weak", "at_s": 0.03, "share": 0.2, "strength": 0.5, "until_s": 0.15},
                {"kind": "remove", "at_s": 0.04, "share": 0.1},
            ]
        },
    ),
    "programs that faults stop, begin anew and slow": (
        "heat",
        {
            "faults": [
                {"kind": "hang", "at_s": 0.02, "share": 0.2, "until_s": 0.15},
                {"kind": "reboot", "at_s": 0.09, "share": 0.3},
                {"kind": "slow_clock", "at_s": 0.03, "share": 0.2, "factor": 0.5},
            ]
        },
    ),
    "sensors and words that faults change": (
        "noisy",
        {
            "faults": [
                {"kind": "sensor_delay", "at_s": 0.02, "share": 0.5, "ticks": 4},
                {"kind": "sensor_flip", "at_s": 0.02, "share": 0.5, "rate": 0.1},
                {"kind": "babble", "at_s": 0.03, "share": 0.1},
            ]
        },
    ),
    "links that faults disturb": (
        "heat",
        {
            "faults": [
                {"kind": "link_loss", "at_s": 0.01, "share": 0.2, "probability": 0.3, "burst_ticks": 4.0},
                {"kind": "link_delay", "at_s": 0.02, "share": 0.2, "between_ticks": (1, 4)},
                {"kind": "link_duplicate", "at_s": 0.03, "share": 0.2, "probability": 0.4},
                {"kind": "link_reorder", "at_s": 0.03, "share": 0.2, "probability": 0.4, "ticks": 3},
                {"kind": "link_bandwidth", "at_s": 0.03, "share": 0.2, "messages_per_s": 100.0, "queue": 3},
                {"kind": "link_corrupt", "at_s": 0.03, "share": 0.2, "probability": 0.2},
            ]
        },
    ),
    "a plan on all cells": ("align", {"duration_s": 1.0}),
}


def scene_of(case: str) -> Scene:
    """The scene of a case, short."""
    name, changes = CASES[case]
    values = {"duration_s": 0.25, **changes}
    return load_scene(name, [Override(tuple(key.split(".")), value, "") for key, value in values.items()])


COMPILED = (
    "clocks and converters", "wheels with rollers", "wheels that feel what they pull", "wide wheels", "uneven supports",
    "wheels that hold",
    "tall parcels",
)  # fmt: skip
"""Cases that compile a kernel each."""


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.slow) if case in COMPILED else case for case in CASES]
)
def test_a_run_that_goes_back_ends_as_one_that_never_did(case: str) -> None:
    scene = scene_of(case)
    run = DirectRun(scene).go(BEFORE)
    memory, before = run.remember(), len(run.events)
    back = DirectRun(scene).recall(memory)
    assert differences(back.process, run.process) == []
    assert differences(back.shard, run.shard) == []
    assert back.go(AFTER).digest.value == run.go(AFTER).digest.value
    assert back.events == run.events[before:]
    assert back.shard.counters() == run.shard.counters()


def test_what_differs_is_found() -> None:
    """The comparison above would see what somebody forgot."""
    scene = scene_of("all effects of sensors and links")
    run, other = DirectRun(scene).go(BEFORE), DirectRun(scene)
    memory = run.remember()
    load_state(other.process, memory[0])
    found = differences(other.shard, run.shard)
    assert any("_delayed" in path for path in found)
    assert any("_received" in path for path in found)


def test_memory_of_another_scene_is_refused() -> None:
    memory = DirectRun(scene_of("a watchdog")).go(2).remember()
    with pytest.raises(StateError, match="must be"):
        DirectRun(scene_of("steps of one length")).recall(memory)
