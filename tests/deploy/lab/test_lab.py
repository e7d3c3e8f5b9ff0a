"""A lab: cells in lockstep without a system, which read, lose and remember what those of a run do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.spec import BusSpec
from cell_firmware.array_view import ArrayView
from deploy.errors import InputError
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from mdms import FirmwareError, InvariantBroken, Lab
from tests.deploy.lab.programs import Counting, Echo, Fails, Gossip

GOALS = {"goals": [{"cell": [0, 0]}]}
EVERY_FAULT = [
    {"kind": "link_loss", "at_tick": 3, "until_tick": 30, "probability": 0.2, "cells": [[0, 0], [1, 2]]},
    {
        "kind": "link_delay",
        "at_tick": 5,
        "until_tick": 25,
        "between_ticks": [0, 3],
        "ordered": False,
        "share": 0.5,
    },
    {"kind": "link_duplicate", "at_tick": 2, "until_tick": 40, "probability": 0.5, "share": 1.0},
    {"kind": "link_reorder", "at_tick": 8, "until_tick": 20, "probability": 0.3, "share": 1.0},
    {"kind": "crash", "at_tick": 6, "until_tick": 11, "cell": [1, 1]},
    {"kind": "crash", "at_tick": 33, "cell": [2, 3]},
    {"kind": "hang", "at_tick": 14, "until_tick": 18, "cell": [0, 2]},
    {"kind": "reboot", "at_s": 0.09, "delay_s": 0.01, "cell": [2, 0]},
    {"kind": "slow_clock", "at_tick": 9, "until_tick": 28, "factor": 0.6, "cell": [2, 1]},
    {"kind": "sensor_stuck", "at_tick": 4, "until_tick": 22, "value": 1, "cells": [[0, 1], [2, 2]]},
]


def _registers_of_run(scene: Any, folder: Path) -> dict[str, Any]:
    options = RunOptions(0, "memory", output=folder, picture=False, registers=1)
    outcome = run(scene, options, quiet=True)
    assert outcome.summary.status == "ok", outcome.summary.reason
    return load(folder).registers


def _assert_equal(lab: Lab, recorded: dict[str, Any], names: tuple[str, ...], ticks: int) -> None:
    for tick in range(ticks):
        lab.step()
        for name in names:
            there = recorded[f"firmware.{name}"][tick]
            assert np.array_equal(lab.registers[name], there), (tick, name)


@pytest.mark.parametrize("firmware", [Echo, Gossip])
@pytest.mark.parametrize("effects", [{}, {"clock": {"error_ppm": 3000}}], ids=["one clock", "clocks"])
def test_a_run_of_the_same_scene_has_the_same_registers_at_every_tick(
    firmware: type, effects: dict[str, Any], tmp_path: Path
) -> None:
    ticks, faults = 45, EVERY_FAULT
    if effects:  # a slow clock and clocks of their own are slow to simulate, and tested elsewhere
        faults = [one for one in EVERY_FAULT if one["kind"] != "slow_clock"]
    lab = Lab(firmware, (3, 4), faults=faults, effects=effects, seed=7, check=None)
    scene = lab.scene.model_copy(update={"duration_s": ticks * lab.scene.tick_ns / 10**9})
    recorded = _registers_of_run(scene, tmp_path)
    _assert_equal(
        lab, recorded, ("sum", "seen") if firmware is Echo else ("most", "periods", "covered"), ticks
    )


@pytest.mark.parametrize("firmware", [Echo, Gossip])
def test_faults_injected_one_by_one_are_a_scene_that_a_run_repeats(firmware: type, tmp_path: Path) -> None:
    lab = Lab(firmware, (3, 3), seed=3)
    seen: list[Any] = []
    name = "sum" if firmware is Echo else "most"

    def step(ticks: int = 1) -> None:
        seen.extend(lab.record(name, ticks))

    step(2)
    lab.lose((1, 1), "south")
    lab.cover((0, 0), (1, 2))
    step(3)
    lab.delay((0, 1), "west", by=2)
    lab.duplicate((1, 0), "east", ticks=2)
    step()
    lab.kill((2, 2), (0, 2))
    lab.cover((0, 0))
    step(4)
    cut = lab.cut((1, 1), "north")
    lab.inject("link_loss", 6, probability=0.5, share=1.0)
    step(2)
    lab.repair((2, 2))
    lab.reboot((2, 0), ticks=3)
    step(3)
    lab.end_fault(cut)
    lab.cover()
    step(5)

    path = tmp_path / "scene.toml"
    lab.save_scene(path, title="What the lab did")
    recorded = _registers_of_run(load_scene(path), tmp_path / "out")[f"firmware.{name}"]
    assert len(recorded) == len(seen) == lab.tick
    dead = lab.lattice.index(
        (0, 2)
    )  # killed for good: it leaves the lockstep of the run, and halts in the lab
    for tick, (mine, theirs) in enumerate(zip(seen, recorded, strict=True)):
        assert np.array_equal(np.delete(mine, dead), np.delete(theirs, dead)), tick


def test_restored_and_branched_labs_go_on_with_the_same_bits() -> None:
    lab = Lab(Echo, (3, 3), faults=EVERY_FAULT[:1], seed=2).step(4)
    lab.kill((1, 1))
    saved = lab.save()
    lab.step(3)
    lab.inject("link_delay", 5, ticks=2, share=1.0)
    lab.repair((1, 1))
    later = lab.save()
    branch = lab.branch()
    first = lab.record("sum", 12)
    assert np.array_equal(branch.record("sum", 12), first)
    lab.restore(later)
    assert np.array_equal(lab.record("sum", 12), first)
    lab.restore(saved)
    assert (lab.tick, (1, 1) in lab.alive) == (4, False)
    assert not np.array_equal(lab.record("sum", 12), first)


def test_a_compiled_program_is_saved_in_the_middle_of_ticks_that_the_kernel_steps() -> None:
    lab = Lab("heat_diffusion", (3, 4))
    lab.registers["speed_m_s", (1, 1)] = [0.1, 0.0]
    saved = lab.step(20).save()
    first = lab.record("speed_m_s", 5)
    assert first.any()
    assert np.array_equal(lab.restore(saved).record("speed_m_s", 5), first)


def test_registers_states_and_messages_are_read_and_set_between_ticks() -> None:
    lab = Lab(Gossip, (1, 3)).step()
    assert lab.registers["most"].tolist() == [0, 1, 2]
    assert lab.outbox[(0, 0), "east"] == {"most": 0} == lab.inbox[(0, 1), "west"]
    lab.inbox[(0, 1), "west"] = {"most": 99}
    lab.outbox[(0, 2), "west"] = None
    lab.step()
    assert lab.registers["most"].tolist() == [1, 99, 2]
    lab.registers["most", (0, 2)] = 200
    lab.states[(0, 0)] = type(lab.states[(0, 0)])(5, periods=7)
    assert lab.states[(0, 0)].periods == 7
    lab.step(3)
    assert lab.registers["most"].tolist() == [200, 200, 200]
    assert lab.registers["periods", (0, 0)] == 10


def test_presence_is_data_a_schedule_or_a_function() -> None:
    bits = np.array([True, False, False])
    assert Lab(Gossip, (1, 3), presence=bits).step(5).registers["covered"].tolist() == [5, 0, 0]
    by_tick = Lab(Gossip, (1, 3), presence={1: [(0, 1)], 3: [(0, 1), (0, 2)], 4: []}).step(6)
    assert by_tick.registers["covered"].tolist() == [0, 3, 1]

    def under_odd(lab: Lab) -> Any:
        return bits & bool(lab.tick % 2)

    assert Lab(Gossip, (1, 3), presence=under_odd).step(5).registers["covered"].tolist() == [2, 0, 0]


def test_a_lattice_is_any_set_of_cells() -> None:
    lab = Lab("hop_gradient", [(0, 0), (0, 1), (1, 1), (2, 1), (2, 0)], parameters=GOALS).step(5)
    assert dict(zip(lab.lattice.cells, lab.registers["distance"].tolist(), strict=True)) == {
        (0, 0): 0, (0, 1): 1, (1, 1): 2, (2, 1): 3, (2, 0): 4,
    }  # fmt: skip


def test_initial_registers_replace_what_init_gives() -> None:
    lab = Lab(Gossip, (1, 3), initial_registers={"most": {"0,0": 50}, "periods": 9})
    assert lab.registers["most"].tolist() == [50, 1, 2]
    assert lab.registers["periods"].tolist() == [9, 9, 9]
    with pytest.raises(FirmwareError, match="no such variable; it has counts, distance, goal, neighbour"):
        Lab("hop_gradient", parameters=GOALS, initial_registers={"distances": 1})


def test_a_broken_invariant_stops_the_lab_with_tick_cells_and_values() -> None:
    with pytest.raises(InvariantBroken) as caught:
        Lab(Counting, (2, 4)).step(10)
    assert str(caught.value) == ("tick 0: 'the number never exceeds 12' is broken at 1,3 most=13.0")
    (found,) = caught.value.violations
    assert (found.tick, found.cells, found.values) == (0, ((1, 3),), {"most": (13.0,)})


def test_conditions_that_come_true_too_late_are_counted_from_the_last_disturbance() -> None:
    lab = Lab(Counting, (1, 5), check="count").step(20)
    assert lab.violations == []
    far = Lab(Counting, (1, 7), check="count").step(20)
    assert [(one.kind, one.tick) for one in far.violations] == [("eventually", 4)]
    far.kill((0, 3))
    far.registers["most", (0, 0)] = 8
    far.step(6)  # two parts know different numbers, and never agree; since the death four ticks have to pass
    assert [one.tick for one in far.violations[1:]] == [24]
    quiet = Lab(Counting, (2, 4), check=None).step(10)
    assert quiet.violations == []


def test_a_failing_program_raises_with_cell_tick_and_traceback() -> None:
    with pytest.raises(
        FirmwareError, match=r"program of cell 0,1 failed in tick 3: ZeroDivisionError: on purpose"
    ):
        Lab(Fails, (1, 3)).step(10)


@pytest.mark.parametrize(
    ("attempt", "says"),
    [
        (lambda lab: lab.kill((9, 9)), "cell 9,9: the array has no such cell; its 9 cells are 0,0 to 2,2"),
        (
            lambda lab: lab.lose((0, 0), "south"),
            "fault link_down: side = south: cell 0,0 has no neighbour there",
        ),
        (
            lambda lab: lab.inject("link_dwn", share=1.0),
            'fault link_dwn: kind = "link_dwn": unknown kind; nearest: link_down',
        ),
        (
            lambda lab: lab.inject("wheel_stuck", share=1.0),
            "kind wheel_stuck: needs the plant: Lab.of(scene, plant=True)",
        ),
        (lambda lab: lab.repair((0, 0)), "cell 0,0: wasn't killed, so it can't be repaired"),
        (
            lambda lab: lab.registers["mist"],
            "register mist: the cells have no such register; they have covered, most, periods",
        ),
        (lambda lab: lab.outbox[(0, 0), "up"], "side 'up': must be one of north, east, south, west"),
        (
            lambda lab: lab.outbox.__setitem__(((0, 0), "east"), {"most": 0.5}),
            "message field most to the east is 0.5: must be a whole number from -2147483648 to 2147483647 (int32)",
        ),
        (
            lambda lab: setattr(lab, "presence", np.zeros(4, dtype=np.bool_)),
            "presence: must be booleans of shape (9,) or (9, 1), not bool of shape (4,)",
        ),
    ],
)
def test_errors_name_the_field_and_the_rule(attempt: Any, says: str) -> None:
    with pytest.raises(InputError) as caught:
        attempt(Lab(Gossip))
    assert str(caught.value) == says


def test_effects_of_the_plant_need_a_plant() -> None:
    with pytest.raises(InputError, match=r"effects.motors: needs the plant: Lab.of\(scene, plant=True\)"):
        Lab.of("motors")


def test_with_a_plant_the_parcels_set_the_presence_bits() -> None:
    changes = {"duration_s": 0.4, "array": {"rows": 3, "columns": 4}}
    scene = {
        **changes,
        "cells": {"firmware": "presence_field", "parameters": {"field": {"kind": "uniform", "velocity_m_s": [0.2, 0]}}},
        "parcels": [{"size_m": [0.15, 0.15], "mass_kg": 1.0, "position_m": [-0.1, 0.0]}],
        "friction": {"law": "viscous", "coefficient_s_per_m": 5.0},
    }  # fmt: skip
    lab = Lab.of(scene, plant=True).step(20)
    assert lab.drives.any()
    saved = lab.save()
    lab.kill((1, 1))
    lab.step(5)
    assert not lab.drives[lab.lattice.index((1, 1))].any()
    lab.restore(saved)
    assert lab.tick == 20
    assert (1, 1) in lab.alive
    with pytest.raises(InputError, match="presence: is the plant's"):
        lab.cover((0, 0))


def test_a_lab_shows_itself_in_a_notebook() -> None:
    lab = Lab(Gossip).step(3)
    assert repr(lab) == "<Lab of tests.deploy.lab.programs:Gossip, 9 cells, before tick 3>"
    assert "covered, most, periods" in lab._repr_html_()


def test_records_of_a_program_file_are_saved(tmp_path: Path) -> None:
    (tmp_path / "counter.py").write_text(
        "from typing import NamedTuple\n"
        "from mdms import CellFirmware, CellOutputs\n"
        "class Count(NamedTuple):\n"
        "    ticks: int = 0\n"
        "class Counter(CellFirmware):\n"
        "    def init(self, cell): return Count()\n"
        "    def step(self, state, inputs): return Count(state.ticks + 1), CellOutputs((0.0, 0.0))\n"
    )
    lab = Lab(str(tmp_path / "counter.py"), (1, 2)).step(3)
    saved = lab.save()
    lab.step(2)
    assert lab.restore(saved).registers["ticks"].tolist() == [3, 3]


def test_registers_are_listed() -> None:
    lab = Lab("heat_diffusion", (2, 2))
    assert "speed_m_s" in lab.registers
    assert list(lab.registers) == list(lab.registers.names)
    assert len(lab.registers) == len(lab.registers.names)
    assert "speed_m_s" in repr(lab.registers)
    with pytest.raises(InputError, match="register 0: the cells have no such register; they have counts"):
        lab.registers[0]  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("protocol", "parameters"),
    [
        ("spanning_tree", {"roots": [{"cell": [0, 0]}, {"cell": [2, 3]}], "limit": 16}),
        ("push_sum", {"values": [{"cell": [0, 0], "value": 1.0}]}),
        ("synchroniser", {"values": [{"cell": [0, 0], "value": 1.0}]}),
    ],
)
def test_conditions_are_due_later_where_messages_take_several_ticks(
    protocol: str, parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = [
        {"kind": "crash", "at_tick": 90, "cell": [0, 0]},
        {"kind": "crash", "at_tick": 120, "cell": [1, 2]},
    ]
    scene = Lab(protocol, (3, 4), parameters=parameters, faults=faults, check=None).scene
    late = scene.model_copy(update={"bus": BusSpec(link_ticks=10)})
    assert not Lab.of(late, check="count").step(2500).violations
    # as if a program's ticks were not those of its messages
    monkeypatch.setattr(ArrayView, "link_ticks", property(lambda _: 1, lambda *_: None), raising=False)
    early = Lab.of(late, check="count").step(2500).violations
    assert bool(early) == (protocol != "synchroniser")  # whose pulses need no more than they are given


@pytest.mark.parametrize("lattice", [5, "2x3", [(0, 0), 3], [(0, 1, 2)], None])
def test_what_is_no_lattice_is_refused(lattice: Any) -> None:
    with pytest.raises(
        InputError, match=r"lattice .*: must be \(rows, columns\), or the \(row, column\) of every cell"
    ):
        Lab(Counting, lattice=lattice)


@pytest.mark.parametrize("lattice", [(2, 3), [2, 3], [(0, 0), (0, 1)]])
def test_lattices_are_sizes_or_cells(lattice: Any) -> None:
    assert len(Lab(Counting, lattice=lattice).lattice) == (2 if lattice[0] == (0, 0) else 6)


def test_a_lab_does_not_step_back() -> None:
    with pytest.raises(InputError, match="ticks -1: must be at least 0"):
        Lab(Counting, lattice=(1, 2)).step(-1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("late", np.ones(2, np.bool_)), "2 values"),
        (np.ones(900), r"array\(\[1., 1., .{1,60}$"),
        (True, "True"),
    ],
)
def test_a_condition_of_another_form_is_refused_in_a_line(given: object, said: str) -> None:
    class Told(Counting):
        def eventually(self, view: ArrayView) -> Any:
            yield given

    with pytest.raises(FirmwareError, match=rf"eventually\(\) must yield \(rule, holds, ticks\), not {said}"):
        Lab(Told, (1, 2)).step()
