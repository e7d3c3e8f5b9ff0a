"""The plant admits processes of cells that agree with it, one a shard, and names the others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bus.errors import BarrierError, BusError
from bus.wire.keys import shard_key
from deploy.scenes.files import load_scene
from deploy.scenes.fingerprint import cells_fingerprint
from deploy.workers.external import ExternalWorkers
from deploy.workers.join import JoinAnswer, JoinRefusal, JoinRequest, decode, encode, request_of
from deploy.workers.plan import RunOptions, plan
from tests.deploy.workers.test_join import ORDER

SCENE = load_scene("motors")
FACTS = cells_fingerprint(SCENE)


class Tokens:
    """Tokens of a run, as a test has them."""

    def __init__(self) -> None:
        self.alive: set[int] = set()
        self.processes: set[tuple[int, str]] = set()

    def shards(self, token: str) -> set[int]:
        return self.alive

    def any_alive(self, shard: int) -> bool:
        return shard in self.alive

    def process_is_there(self, shard: int, process: str) -> bool:
        return (shard, process) in self.processes


class Plant:
    """A plant with two shards, and what it says."""

    def __init__(self) -> None:
        self.tokens, self.said = Tokens(), list[str]()
        made = plan(SCENE, RunOptions(2, external=True, join="tcp/127.0.0.1:0"), "one")
        endpoint: Any = None
        presence: Any = self.tokens
        self.workers = ExternalWorkers(made, SCENE, endpoint, presence, self.said.append)
        self.workers._order = ORDER

    def ask(
        self, shard: int, process: str = "a", key: int | None = None, **more: Any
    ) -> JoinAnswer | JoinRefusal:
        request = request_of(shard, more.pop("shards", 2), process, more.pop("facts", FACTS), **more)
        name = shard_key("one", shard if key is None else key, "join")
        payload = self.workers._answer(SimpleNamespace(payload=encode(request), key=name))  # type: ignore[arg-type]
        return decode(JoinRefusal if b"problem" in payload else JoinAnswer, payload)

    def admit(self, shard: int, process: str) -> None:
        assert isinstance(self.ask(shard, process), JoinAnswer)
        self.tokens.processes.add((shard, process))
        self.tokens.alive.add(shard)


def refusal(answer: JoinAnswer | JoinRefusal) -> JoinRefusal:
    assert isinstance(answer, JoinRefusal)
    return answer


def test_a_process_that_agrees_with_the_plant_is_told_how_to_run_and_another_waits_until_it_goes() -> None:
    plant = Plant()
    plant.admit(0, "a")
    second = refusal(plant.ask(0, "b"))
    assert second.later
    assert second.problem.startswith("taken already: shard 0 (host ")
    plant.tokens.processes.clear()
    assert refusal(plant.ask(0, "b")).problem == "shard 0 is there already"  # its cells' tokens stand yet
    plant.tokens.alive.clear()
    assert isinstance(plant.ask(0, "b"), JoinAnswer)
    assert plant.said == []


def test_a_process_that_differs_is_refused_and_named_at_once_and_at_the_barrier_with_what_differs() -> None:
    plant = Plant()
    other = {**FACTS, "numpy": "1.0", "processor level": "x86-64-v9"}
    refused = refusal(plant.ask(1, facts=other))
    assert not refused.later
    assert f"numpy 1.0, not {FACTS['numpy']}" in refused.problem
    assert "processor level x86-64-v9, not" in refused.problem
    refusal(plant.ask(1, facts=other))
    assert len(plant.said) == 1
    assert refused.problem in plant.said[0]
    error = plant.workers.explained(BarrierError("not every cell is ready", absent=[(0, 0)]))
    assert isinstance(error, BarrierError)
    assert error.absent == ((0, 0),)
    assert "; missing shards: 0, 1; refused: shard 1 (host " in str(error)
    plant.admit(1, "b")
    assert "refused" not in str(plant.workers.explained(BarrierError("not every cell is ready")))
    other_error = BusError("x")
    assert plant.workers.explained(other_error) is other_error


def test_a_scene_that_differs_is_named_by_its_values() -> None:
    seeded = SCENE.model_copy(update={"seed": 7})
    asked = {"facts": cells_fingerprint(seeded), "scene": seeded.canonical()}
    assert refusal(Plant().ask(0, **asked)).problem == f"differs from the plant: seed 7, not {SCENE.seed}"


@pytest.mark.parametrize(("shard", "more"), [(0, {"shards": 3}), (5, {}), (0, {"key": 1})])
def test_a_shard_that_the_plant_does_not_have_is_refused(shard: int, more: dict[str, Any]) -> None:
    assert "the plant has 2 shards" in refusal(Plant().ask(shard, **more)).problem


def test_a_process_whose_program_fails_is_named() -> None:
    plant = Plant()
    plant.admit(0, "a")
    refusal(plant.ask(0, "a", failed="init: no such file"))
    assert plant.said[0].endswith("): init: no such file")


def test_a_run_that_has_begun_takes_a_lost_shard_back_once_for_each_respawn() -> None:
    plant = Plant()
    plant.admit(0, "a")
    plant.workers.begin()
    plant.tokens.alive.clear()
    plant.tokens.processes.clear()
    assert refusal(plant.ask(0, "b")).later
    plant.workers.restart(ORDER, 0)
    answer = plant.ask(0, "b")
    assert isinstance(answer, JoinAnswer)
    assert answer.joins_running
    assert plant.workers.ended(0)  # its token is not there: it has gone again
    plant.tokens.processes.add((0, "b"))
    assert not plant.workers.ended(0)
    plant.tokens.processes.clear()
    assert refusal(plant.ask(0, "c")).later  # not without another respawn


def test_garbage_is_answered_and_changes_nothing() -> None:
    plant = Plant()
    for payload in (b"", b"\xc1", encode(request_of(0, 2, "a", FACTS))[:-1], None):
        made: Any = SimpleNamespace(payload=payload, key="mdms/one/shard/0/join")
        answer = decode(JoinRefusal, plant.workers._answer(made))
        assert answer.problem.startswith("the plant can't read the request")
    assert decode(JoinRequest, encode(request_of(0, 2, "a", FACTS))).facts == FACTS
    assert plant.said == []
