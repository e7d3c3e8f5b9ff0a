"""Mutants: a rule of a piece is dropped, and a search of a small world finds faults that break a condition."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from cell_firmware.protocols import distance2_slots, push_sum, spanning_tree, synchroniser
from cell_firmware.scalar_program import PYTHON
from deploy.studies.adversary.check import check_exhaustively, world_scene
from deploy.studies.adversary.spec import Adversary
from mdms import Lab, kit

TREE, SLOTS, PULSES = "spanning_tree", "distance2_slots", "synchroniser"
WORLDS: dict[str, tuple[tuple[int, int], dict[str, Any], Adversary]] = {
    TREE: ((1, 3), {"limit": 4}, Adversary(1, 4, ("loss", "death"))),
    SLOTS: ((2, 2), {}, Adversary(0, 1, ())),
    PULSES: ((1, 2), {"ttl_periods": 2}, Adversary(2, 8, ("death", "repair"))),
}


@pytest.fixture(autouse=True)
def _in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")


def broken(protocol: str) -> str | None:
    """The rule that a search finds broken."""
    world, parameters, adversary = WORLDS[protocol]
    result, _ = check_exhaustively(world_scene(protocol, world, parameters=parameters), adversary)
    assert not result.limit
    return None if result.violation is None else result.violation.rule


def without_bound(own: Any, valid: Any, keys: Any, hops: Any, _: Any) -> Any:
    """Claims are never dropped."""
    return kit.elect(own, valid, keys, hops, 10**9)


def waits_for_none(pulse: Any, _: Any, heard: Any) -> Any:
    """Pulses go on by themselves, and nobody joins."""
    del heard
    return (pulse + 1) % kit.PULSES


MUTANTS: list[tuple[str, Any, str, Callable[..., Any], str]] = [
    (TREE, spanning_tree, "elect", without_bound, "a root is the least key around"),
    (TREE, spanning_tree, "is_child", lambda *_: True, "every cell knows how many follow its root"),
    (TREE, spanning_tree, "broadcast", lambda *of: of[1], "every cell knows how many follow its root"),
    (SLOTS, distance2_slots, "has_to_move", lambda *_: False, "no two cells within two hops share a slot"),
    (
        SLOTS,
        distance2_slots,
        "has_to_move",
        lambda slot, valid, near, beyond: any(valid[s] and near[s] == slot for s in range(4)),  # both move
        "no two cells within two hops share a slot",
    ),
    (
        SLOTS,
        distance2_slots,
        "has_to_move",
        lambda slot, valid, near, beyond: any(
            valid[s] and near[s] == slot and kit.yields(s, 4) for s in range(4)
        ),  # neighbours alone
        "no two cells within two hops share a slot",
    ),
    (PULSES, synchroniser, "next_pulse", waits_for_none, "pulses of neighbours differ by 1 at most"),
]


@pytest.mark.parametrize("protocol", WORLDS)
def test_the_protocol_itself_holds(protocol: str) -> None:
    assert broken(protocol) is None


@pytest.mark.parametrize(("protocol", "module", "piece", "mutant", "rule"), MUTANTS)
def test_a_mutant_is_found(
    protocol: str,
    module: Any,
    piece: str,
    mutant: Callable[..., Any],
    rule: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, piece, mutant)
    assert broken(protocol) == rule


def mean_error(faults: Any) -> float:
    parameters = {"values": [{"cell": [0, 0], "value": 6.0}]}
    lab = Lab("push_sum", (2, 3), parameters=parameters, faults=faults, check=None, seed=3).step(80)
    return float(abs(lab.registers["estimate"] - 1.0).max())


def test_without_running_sums_lost_messages_lose_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    loss = [{"kind": "link_loss", "at_tick": 0, "until_tick": 40, "probability": 0.3, "share": 1.0}]
    assert mean_error(loss) < 1e-4
    # messages carry shares: a number for each tick, which is read as it is
    monkeypatch.setattr(push_sum, "pushed", lambda total, share: share)
    monkeypatch.setattr(push_sum, "arrived", lambda total, seen: total)
    assert mean_error(()) < 1e-4
    assert mean_error(loss) > 1e-2


def test_without_the_value_of_the_pulse_before_rounds_are_not_those_of_perfect_links(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parameters = {"values": [{"cell": [0, 0], "value": 12.0}]}
    loss = [{"kind": "link_loss", "probability": 0.3, "share": 1.0}]

    def total() -> float:
        lab = Lab("synchroniser", (2, 3), parameters=parameters, faults=loss, check=None).step(60)
        while len(set(lab.registers["pulse"].tolist())) > 1:
            lab.step()
        return float(lab.registers["value"].sum())

    assert total() == pytest.approx(12.0, abs=1e-12)
    monkeypatch.setattr(synchroniser, "value_at", lambda pulse, heard, value, previous: value)
    assert abs(total() - 12.0) > 1e-3
