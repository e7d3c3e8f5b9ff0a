"""The plant in lockstep with cells, on a plant and a host that only keep books."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lockstep.counters import Loss
from bus.spec import StallSpec
from bus.wire.frames import DriveFrame, SenseFrame
from plant.plant import Sense
from plant.process import PlantProcess
from plant.sampling import Timing
from plant.tick import DeathPolicy, RunClock, TickHooks, TickRecord

CELLS = 3
PERIOD_NS = 10


@dataclass
class BookPlant:
    """Cell 0 senses how often the plant was advanced; nothing moves."""

    log: list[Any] = field(default_factory=list)
    advances: int = 0

    @property
    def state(self) -> NDArray[np.float64]:
        return np.full((1, 6), float(self.advances))

    @property
    def wheel_speed(self) -> NDArray[np.float64]:
        return np.zeros((CELLS, 2))

    def sense(self) -> Sense:
        return Sense(np.array([[self.advances % 2 == 1], [False], [False]]), None)

    def advance(
        self, drives: NDArray[np.float64], until_ns: int, timing: Timing | None = None, *, owned: bool = False
    ) -> tuple[Sense, list[Any]]:
        del owned
        self.log.append(("advance", until_ns, drives.tolist()))
        if timing is not None:
            self.log.append(("timing", timing.acts_ns.tolist(), timing.reads_ns.tolist()))
        self.advances += 1
        return self.sense(), []

    def release_wheels(self, cells: Sequence[int], policy: str) -> None:
        self.log.append(("lose", tuple(cells), policy))


@dataclass
class BookHost:
    """Every cell drives ``tick + 1``; some are lost where the test says so."""

    log: list[Any]
    losses: Mapping[int, list[Loss]] = field(default_factory=dict)

    def publish(self, frame: SenseFrame) -> None:
        self.log.append(("publish", frame.tick, bool(frame.presence[0, 0])))

    def gather(self, tick: int) -> tuple[DriveFrame, Sequence[Loss]]:
        return DriveFrame(tick, np.full((CELLS, 2), tick + 1.0)), self.losses.get(tick, [])

    def mark_dead(self, cells: Sequence[int], tick: int) -> None:
        self.log.append(("retire", tuple(cells), tick))


Make = Callable[..., tuple[PlantProcess, BookPlant, list[TickRecord]]]


@pytest.fixture
def make() -> Make:
    def build(
        duration_ns: int = 30,
        policy: Any = "coast",
        schedule: Mapping[int, tuple[int, ...]] | None = None,
        losses: Mapping[int, list[Loss]] | None = None,
        observer: Callable[[TickRecord], None] | None = None,
        pace: Callable[[int], None] | None = None,
        timing: Callable[[int], Timing] | None = None,
    ) -> tuple[PlantProcess, BookPlant, list[TickRecord]]:
        plant, records = BookPlant(), list[TickRecord]()
        process = PlantProcess(
            plant,  # pyright: ignore[reportArgumentType]
            BookHost(plant.log, losses or {}),
            RunClock(PERIOD_NS, duration_ns, timing, pace),
            DeathPolicy(schedule or {}, StallSpec(policy=policy)),
            TickHooks(after_tick=(observer or records.append,)),
        )
        return process, plant, records

    return build


def _untils(plant: BookPlant) -> list[int]:
    return [entry[1] for entry in plant.log if entry[0] == "advance"]


def _drives(plant: BookPlant) -> list[list[float]]:
    return [[row[0] for row in entry[2]] for entry in plant.log if entry[0] == "advance"]


def test_the_run_ends_exactly_at_its_duration_with_a_shorter_last_tick(make: Make) -> None:
    process, plant, records = make(duration_ns=25)
    assert process.run().status == "ok"
    assert _untils(plant) == [10, 20, 25]
    assert (process.tick, process.time_ns) == (3, 25)
    assert [(r.start_ns, r.until_ns) for r in records] == [(0, 10), (10, 20), (20, 25)]


def test_a_run_shorter_than_a_period_has_one_tick(make: Make) -> None:
    process, plant, _ = make(duration_ns=4)
    process.run()
    assert _untils(plant) == [4]


def test_cells_sense_the_state_at_the_start_of_the_tick_their_drives_act_in(make: Make) -> None:
    process, plant, records = make()
    process.run()
    assert [entry[1:] for entry in plant.log if entry[0] == "publish"] == [(0, False), (1, True), (2, False)]
    assert _drives(plant) == [[1.0] * 3, [2.0] * 3, [3.0] * 3]
    assert [(r.before[0, 0], r.after[0, 0]) for r in records] == [(0, 1), (1, 2), (2, 3)]
    assert [bool(r.sense.presence[0, 0]) for r in records] == [False, True, False]


@pytest.mark.parametrize(("policy", "drive"), [("coast", 0.0), ("brake", 0.0), ("hold", 1.0)])
def test_a_scheduled_death_takes_its_drive_away_from_its_tick_on(
    policy: str, drive: float, make: Make
) -> None:
    process, plant, records = make(policy=policy, schedule={1: (2,)})
    assert process.run().status == "ok"
    assert _drives(plant) == [[1.0, 1.0, 1.0], [2.0, 2.0, drive], [3.0, 3.0, drive]]
    assert ("lose", (2,), policy) in plant.log
    assert [r.died for r in records] == [(), (2,), ()]
    assert process.lost.tolist() == [False, False, True]


def test_those_who_die_still_sense_their_last_tick(make: Make) -> None:
    process, plant, _ = make(schedule={1: (2,)})
    process.run()
    assert plant.log.index(("publish", 1, True)) < plant.log.index(("retire", (2,), 1))


def test_holding_at_tick_0_holds_a_wheel_that_never_turned(make: Make) -> None:
    process, plant, _ = make(policy="hold", schedule={0: (0,)})
    process.run()
    assert [drives[0] for drives in _drives(plant)] == [0.0, 0.0, 0.0]


def test_a_loss_is_reported_and_the_run_goes_on_by_the_policy(make: Make) -> None:
    loss = Loss(1, 1, "disconnected")
    process, plant, records = make(policy="hold", losses={1: [loss]})
    assert process.run().status == "ok"
    assert _drives(plant) == [[1.0] * 3, [2.0, 1.0, 2.0], [3.0, 1.0, 3.0]]
    assert [list(r.losses) for r in records] == [[], [loss], []]


def test_a_cell_that_is_lost_does_not_die_again_by_schedule(make: Make) -> None:
    process, plant, records = make(losses={0: [Loss(1, 0, "failed")]}, schedule={2: (1,)})
    process.run()
    assert [entry for entry in plant.log if entry[0] == "lose"] == [("lose", (1,), "coast")]
    assert [r.died for r in records] == [(), (), ()]


@pytest.mark.parametrize(
    ("reason", "status"), [("disconnected", "failed"), ("failed", "failed"), ("timed_out", "stalled")]
)
def test_under_abort_a_loss_ends_the_run_before_the_plant_moves(reason: Any, status: str, make: Make) -> None:
    loss = Loss(0, 1, reason)
    process, plant, records = make(policy="abort", losses={1: [loss]})
    ended = process.run()
    assert (ended.status, ended.losses) == (status, (loss,))
    assert _untils(plant) == [10]
    assert [r.tick for r in records] == [0]


def test_under_abort_a_scheduled_death_ends_the_run_before_its_tick(make: Make) -> None:
    process, plant, records = make(policy="abort", schedule={2: (0, 1)})
    ended = process.run()
    assert (ended.status, ended.died) == ("failed", (0, 1))
    assert _untils(plant) == [10, 20]
    assert [r.tick for r in records] == [0, 1]


def test_every_tick_is_reported_once_and_before_the_next_is_awaited(make: Make) -> None:
    reported: list[int] = []
    process, plant, _ = make(observer=lambda record: plant.log.append(("report", record.tick)))
    process.run()
    reported = [entry[1] for entry in plant.log if entry[0] == "report"]
    assert reported == [0, 1, 2]
    assert plant.log.index(("report", 1)) < plant.log.index(("advance", 30, [[3.0, 3.0]] * 3))


def test_an_observer_can_not_change_the_drives_by_which_the_wheels_go_on(make: Make) -> None:
    def observe(record: TickRecord) -> None:
        record.drives[0] = 7.0

    process, _, _ = make(observer=observe)
    with pytest.raises(ValueError, match="read-only"):
        process.run()


def test_what_the_observer_raises_ends_the_run_between_two_ticks(make: Make) -> None:
    class Enough(Exception):
        pass

    def observe(record: TickRecord) -> None:
        if record.tick == 0:
            raise Enough

    process, plant, _ = make(observer=observe)
    with pytest.raises(Enough):
        process.run()
    assert (process.tick, process.time_ns, plant.advances) == (1, 10, 1)


def test_pacing_waits_before_each_tick_with_all_before_it_reported(make: Make) -> None:
    log: list[Any] = []
    process, _, _ = make(
        observer=lambda record: log.append(("report", record.tick)),
        pace=lambda start_ns: log.append(("pace", start_ns, process.waiting)),
    )
    process.run()
    assert log == [
        ("pace", 0, True), ("report", 0), ("pace", 10, True), ("report", 1), ("pace", 20, True), ("report", 2)
    ]  # fmt: skip
    assert not process.waiting


def _slanting(tick: int) -> Timing:
    """Cell i acts 3 i after a tick begins and reads 3 i + 2 after, but for cell 1, which rests every other tick."""
    acts = 10 * tick + np.array([0, 3, 6])
    reads = acts + 2
    acts[1] = -1 if tick % 2 else acts[1]
    reads[1] = reads[1] if tick % 2 else -1
    return Timing(acts, reads)


def _timings(plant: BookPlant) -> list[Any]:
    return [entry[1:] for entry in plant.log if entry[0] == "timing"]


def test_cells_with_instants_of_their_own_act_and_read_at_them(make: Make) -> None:
    process, plant, records = make(duration_ns=20, timing=_slanting)
    process.run()
    assert _timings(plant) == [([0, 3, 6], [2, -1, 8]), ([10, -1, 16], [12, 15, 18])]
    assert _drives(plant) == [[1.0] * 3, [2.0] * 3]
    assert records[1].drives[:, 0].tolist() == [2.0] * 3


def test_what_would_act_or_be_read_after_the_run_is_neither(make: Make) -> None:
    process, plant, records = make(duration_ns=16, timing=_slanting)
    process.run()
    assert _timings(plant)[1] == ([10, -1, -1], [12, 15, -1])
    assert _drives(plant)[1] == [2.0, 2.0, 1.0]
    assert records[1].drives[:, 0].tolist() == [2.0, 2.0, 1.0]


def test_the_dead_act_as_their_tick_begins_whatever_their_clocks_say(make: Make) -> None:
    process, plant, _ = make(duration_ns=20, timing=_slanting, schedule={1: (2,)})
    process.run()
    assert _timings(plant)[1] == ([10, -1, -1], [12, 15, 18])
    assert _drives(plant)[1] == [2.0, 2.0, 0.0]
