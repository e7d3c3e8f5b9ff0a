"""However a scene is cut, carried and encoded, the same happens in it, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bus.wire.keys import WireFormat
from cell_firmware.effects.registry import CellEffects
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import Processes, RunOptions, Transport

Way = tuple[Processes, Transport, WireFormat]

WAYS: list[Way] = [
    (0, "memory", "packed"),
    (0, "memory", "per_cell"),
    (0, "zenoh", "packed"),
    (0, "zenoh", "per_cell"),
    (1, "zenoh", "packed"),
    (1, "zenoh", "per_cell"),
    (2, "zenoh", "packed"),
    (2, "zenoh", "per_cell"),
    (0, "memory", "relayed"),
    (2, "zenoh", "relayed"),
]
EACH: list[Way] = [("each", "zenoh", "per_cell"), ("each", "zenoh", "packed"), ("each", "zenoh", "relayed")]

CRASHES = """
[stall]
policy = "{policy}"
[[faults]]
kind = "crash"
at_s = 0.0
cell = [0, 0]
[[faults]]
kind = "crash"
at_s = 0.05
cell = [1, 2]
[[faults]]
kind = "crash"
at_s = 0.05
cell = [2, 2]
[[faults]]
kind = "crash"
at_s = 0.1001
cell = [1, 1]
"""


TALKERS = """
from cell_firmware.cell import CellFirmware, CellOutputs
import numpy as np

class Talkers(CellFirmware):
    message = np.dtype([("heat", "<f8")])

    def init(self, cell):
        return 0.05 * cell.column

    def step(self, heat, inputs):
        heard = [message["heat"] for message in inputs.inbox.values() if message is not None]
        heat += sum(0.1 * (other - heat) for other in heard) + 0.01 * inputs.presence[0]
        return heat, CellOutputs((heat, 0.0), dict.fromkeys(inputs.inbox, {"heat": heat}))
"""
"""Firmware in plain Python to which every reading and every message matters."""


def _run(scene: Scene, way: Way, output: Path) -> Summary:
    processes, transport, wire = way
    options = RunOptions(processes, transport, wire, output=output, picture=False)
    outcome = run(scene, options, quiet=True)
    assert outcome.summary.status == "ok", (way, outcome)
    return outcome.summary


def _shortened(name: str, duration_s: float) -> Scene:
    return load_scene(name, [Override(("duration_s",), duration_s, "--duration")])


@pytest.mark.parametrize(
    ("name", "duration_s", "ways"),
    [
        ("elliptic", 0.09, WAYS),
        pytest.param("heat", 0.09, WAYS, marks=pytest.mark.slow),
        pytest.param("coulomb", 0.06, WAYS, marks=pytest.mark.slow),  # another solver
        pytest.param("motors", 0.15, WAYS + EACH, marks=pytest.mark.slow),
    ],
)
def test_the_digest_depends_neither_on_processes_nor_on_transport_nor_on_wire_form(
    name: str, duration_s: float, ways: list[Way], tmp_path: Path
) -> None:
    scene = _shortened(name, duration_s)
    digests = {way: _run(scene, way, tmp_path).digest for way in [*ways, ways[0], ways[4]]}
    assert len(set(digests.values())) == 1, digests


HEAT = "cells.parameters={held=[{columns=[0, 9], speed_m_s=[0.05, 0.02]}]}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        ("effects.motors={}",),
        ("effects.motors={}", "effects.clock={}"),
        ("effects.motors={}", "cells.firmware=heat_diffusion", HEAT),
        ("cells.firmware=heat_diffusion", HEAT),
    ],
    ids=["motors", "clocks", "motors and messages", "messages"],
)
def test_so_it_is_with_payloads_of_thousands_of_cells(changes: tuple[str, ...], tmp_path: Path) -> None:
    scene = load_scene("large", [Override.parse(change) for change in ("duration_s=0.03", *changes)])
    ways: list[Way] = [
        (0, "memory", "packed"),
        (1, "zenoh", "packed"),
        (2, "zenoh", None),
        (2, "zenoh", "packed"),
    ]
    assert len({_run(scene, way, tmp_path).digest for way in ways}) == 1


EVERYTHING = (
    "effects.analogue_sensors={ spot_radius_m = 0.02 }",
    "effects.adc={ noise_codes = 2.0 }",
    "effects.sensor={ threshold = 0.4, hysteresis = 0.2, false_positive = 0.01, debounce_ticks = 2 }",
    "effects.sensor.latency_ticks=1",
    "effects.link_loss={ probability = 0.1 }",
    "effects.link_delay={ between_ticks = [0, 2] }",
    "effects.clock={ error_ppm = 20000, exchanges_per_period = 2 }",
)
"""What the scene ``prototype`` lacks of the cells' effects, and clocks far apart."""


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), EVERYTHING], ids=["as it is", "with every effect of the cells"])
def test_boards_act_alike_however_the_scene_is_cut(more: tuple[str, ...], tmp_path: Path) -> None:
    scene = load_scene("prototype", [Override.parse(change) for change in ("duration_s=0.15", *more)])
    if more:
        assert {name for name, _ in scene.effects.enabled()} >= set(CellEffects.model_fields)
    summaries = {way: _run(scene, way, tmp_path) for way in [*WAYS, EACH[0], EACH[2]]}
    assert {summary.status for summary in summaries.values()} == {"ok"}
    assert len({summary.digest for summary in summaries.values()}) == 1
    assert len({str(summary.effects) for summary in summaries.values()}) == 1
    assert summaries[WAYS[0]].effects["serial.received"] > 0


@pytest.mark.slow
def test_parcels_that_come_and_go_do_so_alike_however_the_scene_is_cut(tmp_path: Path) -> None:
    scene = load_scene(
        "stream",
        [
            Override.parse(change)
            for change in (
                "duration_s=0.4",
                "effects.feeders.feed.0.mean_s=0.05",
                "effects.feeders.exits.0.position_m=[-1.05,0.4]",
                "effects.feeders.exits.1.position_m=[-1.05,-0.4]",
            )
        ],
    )
    summaries = [_run(scene, way, tmp_path) for way in (WAYS[0], WAYS[4], WAYS[7])]
    assert len({summary.digest for summary in summaries}) == 1
    counts = [summary.feeders for summary in summaries]
    assert counts[0] == counts[1] == counts[2]
    assert counts[0] is not None
    assert counts[0].left > 0
    assert counts[0].feed[0].held_back > 0


def test_the_digest_depends_on_what_happens(tmp_path: Path) -> None:
    scene = _shortened("motors", 0.05)
    other = load_scene(
        "motors",
        [Override(("duration_s",), 0.05, ""), Override(("parcels", 0, "angle_rad"), 0.1500001, "")],
    )
    assert _run(scene, WAYS[0], tmp_path).digest != _run(other, WAYS[0], tmp_path).digest


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["hold", "coast", "brake"])
def test_scheduled_crashes_act_alike_in_shared_workers_and_in_processes_of_their_own(
    policy: str, small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = load_scene(str(small(CRASHES.format(policy=policy))))
    ways = [WAYS[0], WAYS[4], WAYS[6], WAYS[7], *EACH]
    summaries = {way: _run(scene, way, tmp_path) for way in ways}
    assert len({summary.digest for summary in summaries.values()}) == 1, summaries
    for summary in summaries.values():
        assert list(summary.cells_lost) == [(0, 0), (1, 2), (2, 2), (1, 1)]
        assert [(f["kind"], f["tick"]) for f in summary.faults] == [
            ("crash", 0), ("crash", 13), ("crash", 13), ("crash", 25)
        ]  # fmt: skip


def _talkers(small: Callable[[str], Path], folder: Path, more: str, **effects: dict[str, object]) -> Scene:
    (folder / "talkers.py").write_text(TALKERS)
    firmware = Override(("cells",), {"firmware": str(folder / "talkers.py")}, "")
    return load_scene(str(small(more)), [firmware, Override(("effects",), effects, "")])


@pytest.mark.slow
def test_chance_and_delay_act_alike_however_the_scene_is_cut_and_crashes_do_not_change_that(
    small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = _talkers(
        small,
        tmp_path,
        CRASHES.format(policy="coast"),
        analogue_sensors={"spot_radius_m": 0.04},
        adc={"noise_codes": 20.0},
        sensor={
            "threshold": 0.4,
            "hysteresis": 0.2,
            "false_positive": 0.1,
            "false_negative": 0.2,
            "debounce_ticks": 2,
            "latency_ticks": 1,
        },
        link_loss={"probability": 0.1},
        link_delay={"between_ticks": [0, 3], "ordered": False},
    )
    summaries = {way: _run(scene, way, tmp_path) for way in [WAYS[0], WAYS[4], WAYS[7], *EACH]}
    assert len({summary.digest for summary in summaries.values()}) == 1, summaries
    counted = [summary.effects for summary in summaries.values()]
    assert all(one == counted[0] for one in counted)
    assert counted[0].keys() == {
        "link_delay.overtaken", "link_loss.lost",
        "sensor.bounces", "sensor.false_negatives", "sensor.false_positives",
    }  # fmt: skip
    assert min(counted[0].values()) > 0


@pytest.mark.slow
def test_cells_with_clocks_of_their_own_do_alike_however_the_scene_is_cut(
    small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = _talkers(
        small,
        tmp_path,
        CRASHES.format(policy="hold"),
        clock={"error_ppm": 60_000.0, "exchanges_per_period": 2},
        link_delay={"between_ticks": [0, 3]},
        motors={},
    )
    summaries = {way: _run(scene, way, tmp_path) for way in [WAYS[0], WAYS[4], WAYS[7], *EACH]}
    assert len({summary.digest for summary in summaries.values()}) == 1, summaries
    assert {summary.ticks for summary in summaries.values()} == {scene.ticks}
    counted = [summary.effects for summary in summaries.values()]
    assert all(one == counted[0] for one in counted)
    assert counted[0]["clock.overwritten"] > 0
    other = _run(scene.model_copy(update={"seed": scene.seed + 1}), WAYS[0], tmp_path)
    assert other.digest != summaries[WAYS[0]].digest


@pytest.mark.slow
def test_serial_lines_between_clocks_that_differ_do_alike_however_the_scene_is_cut(tmp_path: Path) -> None:
    changes = ("duration_s=0.3", "effects.clock={ error_ppm = 60_000 }", "effects.serial.sharing=mux")
    scene = load_scene("serial", [Override.parse(change) for change in changes])
    summaries = [_run(scene, way, tmp_path) for way in (WAYS[0], WAYS[5], WAYS[6])]
    assert len({summary.digest for summary in summaries}) == 1, summaries
    counted = [summary.effects for summary in summaries]
    assert counted[0] == counted[1] == counted[2]
    assert min(counted[0][f"serial.{what}"] for what in ("received", "framing", "unheard")) > 0


def test_effects_of_the_cells_that_change_nothing_leave_every_recorded_byte_as_it_was(
    small: Callable[[str], Path], tmp_path: Path
) -> None:
    silent = {"sensor": {}, "link_loss": {"probability": 0.0}, "link_delay": {"ticks": 0}}
    noisy = {"sensor": {"false_negative": 0.5}}
    ran: list[list[bytes]] = []
    for effects in ({}, silent, noisy):
        assert _run(_talkers(small, tmp_path, "", **effects), WAYS[0], tmp_path).effects.keys() == (
            {"sensor.false_positives", "sensor.false_negatives"} if effects is noisy else set()
        )
        recorded = load(tmp_path)
        arrays = (recorded.presence, recorded.drives, recorded.wheel_speeds, recorded.parcels)
        ran.append([array.tobytes() for array in arrays])
    assert ran[0] == ran[1]
    assert ran[0][1] != ran[2][1]
