"""Messages of vectors, records and lists in whole runs: one digest, recorded, traced and exported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.recordings.exports.registry import export_recording
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

TYPE = """
import numpy as np
from mdms import SIDES, CellFirmware, CellOutputs, Firmware, Outbox, Outputs, ScalarProgram, bounded_list

MESSAGE = np.dtype([
    ("near", [("heat", "<f8"), ("hops", "u1")]), ("power", "<f4", (2,)), ("path", bounded_list("<i2", 3)),
])
"""
PLAIN = """
class Talker(CellFirmware):
    message = MESSAGE

    def value_ranges(self):
        return {"near.heat": (-10.0, 10.0), "power": (-10.0, 10.0), "path.items": (0.0, 12.0)}

    def init(self, cell):
        return 0.05 * cell.column, 0

    def step(self, state, inputs):
        heat, tick = state
        for side in SIDES:
            got = inputs.inbox[side]
            if got is not None:
                heat = heat + 0.05 * (got["near"]["heat"] - heat) + 0.001 * got["power"][1]
                heat = heat + 0.0001 * len(got["path"]) + 0.00001 * sum(got["path"])
        sent = {
            "near": {"heat": heat, "hops": tick % 7}, "power": (0.5, 0.1 * heat),
            "path": tuple(range(tick % 7, tick % 7 + tick % 4)),
        }
        return (heat, tick + 1), CellOutputs((heat, 0.01 * inputs.presence[0]), dict.fromkeys(SIDES, sent))
"""
ARRAYS = """
class Talker(Firmware):
    message = MESSAGE

    def value_ranges(self):
        return {"near.heat": (-10.0, 10.0), "power": (-10.0, 10.0), "path.items": (0.0, 12.0)}

    def init(self, cells):
        return {"heat": 0.05 * cells.column, "tick": np.zeros(len(cells), np.int64)}

    def step(self, state, inputs):
        heat, tick, box = state["heat"], state["tick"], inputs.inbox
        for side in range(4):
            got, there = box.message[:, side], box.received[:, side]
            new = heat + 0.05 * (got["near"]["heat"] - heat) + 0.001 * got["power"][:, 1].astype(np.float64)
            items = got["path"]["items"].astype(np.int64)
            new = new + 0.0001 * got["path"]["length"] + 0.00001 * (items[:, 0] + items[:, 1] + items[:, 2])
            heat = np.where(there, new, heat)
        outbox = Outbox.empty(len(heat), self.message)
        outbox.sent[...] = True
        message = outbox.message
        message["near"]["heat"], message["near"]["hops"] = heat[:, None], (tick % 7)[:, None]
        message["power"][..., 0], message["power"][..., 1] = 0.5, 0.1 * heat[:, None]
        message["path"]["length"] = (tick % 4)[:, None]
        message["path"]["items"] = (tick % 7)[:, None, None] + np.arange(3)
        speed = np.stack((heat, 0.01 * inputs.presence[:, 0]), axis=1)
        return {"heat": heat, "tick": tick + 1}, Outputs(speed, outbox)
"""
SCALAR = """
class Talker(ScalarProgram):
    message = MESSAGE
    state_type = np.dtype([("heat", "<f8"), ("tick", "<i8")])

    def init(self, cells):
        return {"heat": 0.05 * cells.column, "tick": np.zeros(len(cells), np.int64)}

    @staticmethod
    def cell_step(constants, state, inputs, outputs):
        heat = state.heat
        for side in range(4):
            if inputs.received[side]:
                got = inputs.message[side]
                heat = heat + 0.05 * (got.near.heat - heat) + 0.001 * float(got.power[1])
                total = 0
                for i in range(got.path.length):
                    total += int(got.path.items[i])
                heat = heat + 0.0001 * int(got.path.length) + 0.00001 * total
        for side in range(4):
            outputs.sent[side] = 1
            message = outputs.message[side]
            message.near.heat, message.near.hops = heat, state.tick % 7
            message.power[0], message.power[1] = 0.5, 0.1 * heat
            message.path.length = state.tick % 4
            for i in range(state.tick % 4):
                message.path.items[i] = state.tick % 7 + i
        state.heat, state.tick = heat, state.tick + 1
        outputs.speed_m_s[0], outputs.speed_m_s[1] = heat, 0.01 * inputs.presence[0]
"""
FORMS = {"plain": PLAIN, "arrays": ARRAYS, "scalar": SCALAR}
FAULTS = """
[[faults]]
kind = "lie"
mode = "offset"
by = 2.0
at_s = 0.02
cell = [0, 0]
[[faults]]
kind = "link_corrupt"
bits = 3
probability = 0.3
at_s = 0.04
cell = [1, 1]
[[faults]]
kind = "babble"
at_s = 0.06
cell = [2, 2]
"""


def talkers(form: str, small: Callable[[str], Path], folder: Path, more: str = "", **effects: Any) -> Scene:
    path = folder / "talkers.py"  # one name: it is part of the digest
    path.write_text(TYPE + FORMS[form])
    overrides = [Override(("cells",), {"firmware": str(path)}, ""), Override(("effects",), effects, "")]
    return load_scene(str(small(more)), overrides)


def summary_of(scene: Scene, folder: Path, way: tuple[Any, Any, Any], **options: Any) -> Summary:
    processes, transport, wire = way
    asked = RunOptions(processes, transport, wire, output=folder, picture=False, **options)
    outcome = run(scene, asked, quiet=True)
    assert outcome.summary.status == "ok", outcome
    return outcome.summary


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_one_digest_over_forms_processes_and_wire_formats(
    small: Callable[[str], Path], tmp_path: Path
) -> None:
    digests = {
        form: summary_of(
            talkers(form, small, tmp_path), tmp_path / "run", (0, "memory", "packed")
        ).motion_digest
        for form in FORMS
    }
    scene = talkers("scalar", small, tmp_path)
    for way in [
        (0, "memory", "per_cell"),
        (2, "zenoh", "packed"),
        (2, "zenoh", "relayed"),
        (2, "zenoh", "per_cell"),
    ]:
        digests[str(way)] = summary_of(scene, tmp_path / "run", way).motion_digest
    assert len(set(digests.values())) == 1, digests


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "faults"),
    [
        ({"serial": {"baud": 31250}, "link_loss": {"probability": 0.1}}, FAULTS),
        ({"serial": {"baud": 31250}}, ""),
        (
            {
                "clock": {"error_ppm": 20000, "exchanges_per_period": 2},
                "link_delay": {"between_ticks": [0, 2]},
            },
            FAULTS,
        ),
    ],
    ids=["serial lines", "serial lines, whole messages", "clocks"],
)
def test_lines_clocks_and_faults_act_alike_however_the_scene_is_cut(
    effects: dict[str, Any], faults: str, small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = talkers("plain", small, tmp_path, faults, **effects)
    ways = [(0, "memory", "packed"), (2, "zenoh", "relayed")]
    summaries = [summary_of(scene, tmp_path / "run", way) for way in ways]
    assert summaries[0].digest == summaries[1].digest
    assert summaries[0].effects == summaries[1].effects
    if faults:
        counted = summaries[0].effects  # on serial lines the check byte finds what is damaged
        assert counted["faults.lie.messages"] > 0
        assert counted["faults.words.refused"] + counted.get("serial.damaged", 0) > 0
    arrays = talkers("arrays", small, tmp_path, faults, **effects)
    assert summary_of(arrays, tmp_path / "run", ways[0]).motion_digest == summaries[0].motion_digest


@pytest.mark.slow
def test_messages_are_recorded_traced_and_exported_by_dotted_names(
    small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = talkers("plain", small, tmp_path)
    folder = tmp_path / "run"
    summary_of(scene, folder, (0, "memory", "packed"), messages=1, trace_messages="all")
    recording = load(folder)
    names = ["near.heat", "near.hops", "power", "path.length", "path.items"]
    assert list(recording.messages) == ["sent", *names]
    ticks = recording.message_tick
    assert recording.messages["path.items"].shape == (len(ticks), 12, 4, 3)
    np.testing.assert_array_equal(recording.messages["path.length"][:, 0, 0], ticks % 4)
    traced = recording.traced_messages()
    assert {message.fate for message in traced} == {"read", "under way"}
    assert traced[0].sent.keys() == set(names)
    assert traced[0].sent["power"] == [0.5, pytest.approx(0.0)]
    for format_ in ("csv", "parquet", "netcdf"):
        assert export_recording(recording, format_, tmp_path / format_)
