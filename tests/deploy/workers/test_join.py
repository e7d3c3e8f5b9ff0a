"""What a process of cells and a plant say to each other before the process joins: checked, whoever sends it."""

from __future__ import annotations

from dataclasses import fields, replace

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.lockstep.registers import RegisterRequest
from bus.partition import Partition
from bus.sensors import SensorSchema
from deploy.errors import DeployError
from deploy.scenes.files import load_scene
from deploy.workers.join import (
    JoinAnswer,
    JoinRefusal,
    JoinRequest,
    decode,
    encode,
    request_of,
)
from deploy.workers.worker import ResumePoint, WorkerConfig
from plant.array import CellArray

SCENE = load_scene("motors")
ORDER = WorkerConfig(
    scene=SCENE,
    array=CellArray(SCENE.array),
    partition=Partition.even(SCENE.lattice(), 2),
    wire="per_cell",
    run="one",
    connect="tcp/127.0.0.1:1",
    sensors=SensorSchema(2, encoders=True, levels=True, labels=3, camera=4),
    register_requests=(RegisterRequest(5), RegisterRequest(1, frozenset({"a", "b"}))),
    metered=True,
    byte_accurate_links=True,
    joins_running=False,
    keys=(),
    own_process=True,
    snapshots=True,
    messages=True,
    traced=True,
    resumed=ResumePoint(7, (1, 2), {0: b"state"}, {0: ((b"sent", b"message"),)}, {}),
)
ASKED = request_of(1, 2, "abc123", {"numpy": "2.1"}, b"{}")


def vars_of(point: ResumePoint | None) -> list[object]:
    return [getattr(point, f.name) for f in fields(ResumePoint)]


def test_a_process_is_configured_as_the_plant_s_own_workers_are() -> None:
    answer = decode(JoinAnswer, encode(JoinAnswer.of(ORDER, 0, joins_running=False)))
    made = answer.config(SCENE, ORDER.partition, "one", 0)
    assert vars_of(made.resumed) == vars_of(ORDER.resumed)
    own = replace(made, resumed=ORDER.resumed, connect=ORDER.connect, array=ORDER.array, killed=True)
    differing = [f.name for f in fields(own) if getattr(own, f.name) != getattr(ORDER, f.name)]
    assert differing == []
    assert not made.killed


def test_a_shard_without_live_cells_resumes_without_a_state_and_one_that_rejoins_does_not_resume() -> None:
    dead = JoinAnswer.of(ORDER, 1, joins_running=False).config(SCENE, ORDER.partition, "one", 1)
    assert dead.resumed is not None
    assert dead.resumed.states == {}
    assert JoinAnswer.of(ORDER, 0, joins_running=True).resumed is None


def test_a_request_names_its_process_and_leaves_a_scene_out_that_is_too_long() -> None:
    assert decode(JoinRequest, encode(ASKED)) == ASKED
    assert ASKED.whose.startswith("shard 1 (host ")
    assert request_of(0, 1, "a", {}, bytes(40_000)).scene == b""
    assert "\x1b" not in ASKED.model_copy(update={"host": "\x1b[2J"}).whose


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"v": 1}, "v: "),
        ({"shard": -1}, "shard: "),
        ({"shard": True}, "shard: "),
        ({"process": "../x"}, "process: "),
        ({"facts": {"a": 1}}, "facts.a: "),
        ({"scene": "text"}, "scene: "),
        ({"more": 1}, "more: "),
    ],
)
def test_a_field_that_is_wrong_is_named(changed: dict[str, object], problem: str) -> None:
    payload = msgpack.packb({**ASKED.model_dump(), **changed})
    with pytest.raises(DeployError, match=f"^{problem}"):
        decode(JoinRequest, payload)


@given(st.binary(max_size=300) | st.just(encode(ASKED)).map(lambda text: text[:-3]) | st.none())
def test_bytes_are_a_message_or_an_error_of_ours(payload: bytes | None) -> None:
    for kind in (JoinRequest, JoinAnswer, JoinRefusal):
        try:
            decode(kind, payload)
        except DeployError:
            continue
