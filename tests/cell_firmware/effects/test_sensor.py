"""Presence sensors that err and lag: what cells see, against what is there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import binom

from bus.lattice import Lattice
from cell_firmware.clocks import NOT_IN_WINDOW
from cell_firmware.effects.base import InputFilter, ShardContext
from cell_firmware.effects.clock.spec import ClockSpec
from cell_firmware.effects.sensor import SensorSpec
from cell_firmware.firmware import Inputs

Bools = NDArray[np.bool_]
CELLS, SENSORS, TICKS = 900, 3, 40
ALL = slice(None)


def stages_of(spec: SensorSpec, seed: int = 5, *, levels: bool = False) -> list[InputFilter]:
    return list(spec.input_filters(ShardContext(np.arange(CELLS), SENSORS, None, seed, levels=levels)))


def seen(stages: list[InputFilter], presence: Bools, alive: NDArray[np.int64] | slice = ALL) -> Bools:
    """What cells see, ``(ticks, n, sensors)``, of what is there."""
    read: list[Bools] = []
    for tick, there in enumerate(presence):
        inputs = Inputs(there)
        for stage in stages:
            inputs = stage.apply(tick, inputs, alive)
        read.append(inputs.presence)
    return np.array(read)


def switched(spec: SensorSpec, level: NDArray[np.float64]) -> Bools:
    """Bits ``(ticks, n, sensors)`` that sensors make of levels."""
    stages, read = stages_of(spec, levels=True), []
    for now in level:
        inputs = Inputs(np.zeros((CELLS, SENSORS), dtype=np.bool_), None, None, now)
        for stage in stages:
            inputs = stage.apply(len(read), inputs, ALL)
        read.append(inputs.presence)
    return np.array(read)


@pytest.fixture(scope="module")
def level() -> NDArray[np.float64]:
    """Levels that wander about one half, some of them at it exactly."""
    steps = np.random.default_rng(3).normal(0.0, 0.1, (TICKS, CELLS, SENSORS))
    walk = np.clip(0.5 + np.cumsum(steps, axis=0), 0.0, 1.0)
    return np.round(walk * 20.0) / 20.0


@pytest.fixture(scope="module")
def there() -> Bools:
    return np.random.default_rng(1).random((TICKS, CELLS, SENSORS)) < 0.4


def within(count: int, of: int, probability: float) -> bool:
    """Whether a count is between the binomial's quantiles of 1e-4 on either side."""
    return bool(binom.ppf(1e-4, of, probability) <= count <= binom.ppf(1 - 1e-4, of, probability))


def test_sensors_err_at_the_requested_rates_and_errors_are_counted(there: Bools) -> None:
    (errors,) = stages_of(SensorSpec(false_positive=0.01, false_negative=0.2))
    wrong = seen([errors], there) ^ there
    positives, negatives = int((wrong & ~there).sum()), int((wrong & there).sum())
    assert within(positives, int((~there).sum()), 0.01)
    assert within(negatives, int(there.sum()), 0.2)
    assert errors.counters == {"false_positives": positives, "false_negatives": negatives}


def test_errors_of_neighbouring_ticks_cells_and_sensors_have_nothing_to_do_with_each_other(
    there: Bools,
) -> None:
    wrong = seen(stages_of(SensorSpec(false_positive=0.3, false_negative=0.3)), there) ^ there
    pairs = (
        (wrong[1:], wrong[:-1]),
        (wrong[:, 1:], wrong[:, :-1]),
        (wrong[:, :, 1:], wrong[:, :, :-1]),
    )
    for one, other in pairs:
        assert within(int((one & other).sum()), one.size, 0.3 * 0.3)


def test_certain_errors_turn_every_reading_round(there: Bools) -> None:
    assert (seen(stages_of(SensorSpec(false_positive=1, false_negative=1)), there) == ~there).all()


def test_a_cell_sees_what_was_read_exactly_so_many_ticks_ago_and_nothing_before(there: Bools) -> None:
    late = seen(stages_of(SensorSpec(latency_ticks=7)), there)
    assert not late[:7].any()
    assert (late[7:] == there[:-7]).all()


@pytest.mark.parametrize("exchanges", [1, 2, 5])
@pytest.mark.parametrize("debounce", [2, 3])
def test_debouncing_counts_each_reading_of_a_cells_own_period_once(exchanges: int, debounce: int) -> None:
    """Crystals off by up to 3 %: slow cells have windows without a reading, with one exchange a period too."""
    lattice = Lattice((0, column) for column in range(40))
    spec = ClockSpec(error_ppm=30_000.0, exchanges_per_period=exchanges)
    clocks = spec.clocks(lattice, 4_096_000, 7).clocks
    n, ticks, chance = len(lattice), 80 * exchanges, np.random.default_rng(2)
    stages = list(
        SensorSpec(debounce_ticks=debounce).input_filters(
            ShardContext(np.arange(n), 1, None, 1, clocks=clocks)
        )
    )
    pins, read, believed = np.zeros((n, 1), dtype=np.bool_), [[] for _ in range(n)], [[] for _ in range(n)]
    for tick in range(ticks):
        instants = clocks.instants(tick - 1)
        due = np.flatnonzero(instants != NOT_IN_WINDOW)
        pins[due, 0] = chance.random(len(due)) < 0.5
        (stage,) = stages
        filtered = stage.apply(tick, Inputs(pins.copy()), ALL).presence
        for cell in due.tolist():
            read[cell].append(bool(pins[cell, 0]))
            believed[cell].append(bool(filtered[cell, 0]))
    bounces = 0
    for theirs, found in zip(read, believed, strict=True):
        bit, row = False, 0
        for reading, shown in zip(theirs, found, strict=True):
            bounces += reading == bit and row > 0
            row = row + 1 if reading != bit else 0
            if row == debounce:
                bit, row = reading, 0
            assert shown is bit
    assert stages[0].counters["bounces"] == bounces > 100


def test_errors_are_those_of_the_reading_however_long_it_takes(there: Bools) -> None:
    errors = SensorSpec(false_positive=0.1, false_negative=0.1)
    at_once = seen(stages_of(errors), there)
    late = seen(stages_of(errors.model_copy(update={"latency_ticks": 3})), there)
    assert not late[:3].any()
    assert (late[3:] == at_once[:-3]).all()


def test_the_dead_are_not_counted(there: Bools) -> None:
    alive = np.arange(0, CELLS, 2)
    (errors,) = stages_of(SensorSpec(false_negative=0.5))
    wrong = seen([errors], there, alive) ^ there
    assert errors.counters["false_negatives"] == wrong[:, alive].sum()


def test_another_seed_makes_other_errors(there: Bools) -> None:
    spec = SensorSpec(false_positive=0.1)
    assert (seen(stages_of(spec, 1), there) != seen(stages_of(spec, 2), there)).any()


def test_a_level_of_one_half_or_more_is_something_there_unless_the_scene_says_another(
    level: NDArray[np.float64],
) -> None:
    assert np.array_equal(switched(SensorSpec(), level), level >= 0.5)
    assert np.array_equal(switched(SensorSpec(threshold=0.25), level), level >= 0.25)
    assert np.array_equal(switched(SensorSpec(threshold=1.0), level), level >= 1.0)


def test_hysteresis_holds_the_bit_between_its_two_levels(level: NDArray[np.float64]) -> None:
    found = switched(SensorSpec(threshold=0.5, hysteresis=0.25), level)
    held = 0
    for cell in range(0, CELLS, 9):
        bit = False
        for tick in range(TICKS):
            now = float(level[tick, cell, 1])
            if now >= 0.625:
                bit = True
            elif now < 0.375:
                bit = False
            else:
                held += bit != (now >= 0.5)
            assert bool(found[tick, cell, 1]) is bit
    assert held > 20
    # at the two levels themselves: on from the upper on, off only below the lower
    steps = np.array([0.5, 0.625, 0.375, 0.625, np.nextafter(0.375, 0.0), np.nextafter(0.625, 0.0)])
    edge = switched(SensorSpec(hysteresis=0.25), np.broadcast_to(steps[:, None, None], (6, CELLS, SENSORS)))
    assert edge[:, 0, 0].tolist() == [False, True, True, True, False, False]


def test_presence_as_the_plant_has_it_counts_for_nothing_where_there_are_levels() -> None:
    stages = stages_of(SensorSpec(), levels=True)
    inputs = Inputs(np.ones((CELLS, SENSORS), dtype=np.bool_), None, None, np.zeros((CELLS, SENSORS)))
    for stage in stages:
        inputs = stage.apply(0, inputs, ALL)
    assert not inputs.presence.any()


def test_without_levels_a_threshold_s_default_is_no_stage(there: Bools) -> None:
    errors = SensorSpec(false_positive=0.1, latency_ticks=2)
    assert len(stages_of(errors)) == 2
    assert len(stages_of(errors, levels=True)) == 3


@pytest.mark.parametrize("ticks", [2, 5])
def test_a_change_is_believed_once_it_has_been_read_so_many_times_in_a_row(ticks: int) -> None:
    # long stretches, so that some changes last and some don't
    change = np.random.default_rng(8).random((TICKS, CELLS, SENSORS)) < 0.3
    read = np.logical_xor.accumulate(change, axis=0)
    (debounce,) = stages_of(SensorSpec(debounce_ticks=ticks))
    found = seen([debounce], read)
    bounced = 0
    for cell in range(CELLS):
        for sensor in range(SENSORS):
            believed, recent = False, [False] * ticks
            for tick in range(TICKS):
                now = bool(read[tick, cell, sensor])
                bounced += now == believed and recent[-1] != believed
                recent = [*recent[1:], now]
                if all(one != believed for one in recent):
                    believed = not believed
                assert bool(found[tick, cell, sensor]) is believed
    assert debounce.counters == {"bounces": bounced}
    assert bounced > 100


def test_a_bit_that_stays_comes_so_many_readings_late() -> None:
    read = np.zeros((TICKS, CELLS, SENSORS), dtype=np.bool_)
    read[10:20] = True
    found = seen(stages_of(SensorSpec(debounce_ticks=4, latency_ticks=2)), read)
    assert np.flatnonzero(found[:, 0, 0]).tolist() == list(range(15, 25))


def test_errors_come_before_debouncing_and_latency_after(there: Bools) -> None:
    settings = {"false_positive": 0.2, "false_negative": 0.2, "debounce_ticks": 3, "latency_ticks": 4}
    stages = stages_of(SensorSpec(**settings))
    wrong = seen(stages_of(SensorSpec(false_positive=0.2, false_negative=0.2)), there)
    steady = seen(stages_of(SensorSpec(debounce_ticks=3)), wrong)
    late = seen(stages_of(SensorSpec(latency_ticks=4)), steady)
    assert (seen(stages, there) == late).all()
    assert (steady != wrong).any()


def test_firmware_that_writes_to_what_it_sees_changes_no_sensor() -> None:
    threshold, debounce = stages_of(SensorSpec(hysteresis=0.5, debounce_ticks=2), levels=True)
    ones = np.ones((CELLS, SENSORS))
    for stage in (threshold, debounce):
        for tick, level in enumerate((1.0, 1.0, 0.5, 0.5)):
            filtered = stage.apply(tick, Inputs(ones > 0.0, None, None, level * ones), ALL).presence
            assert filtered.all() or (stage is debounce and tick == 0)
            filtered[:] = False


def test_a_threshold_needs_levels_and_nothing_else_of_a_sensor_does() -> None:
    assert SensorSpec(false_positive=0.1, debounce_ticks=2, latency_ticks=1).required() == ()
    assert SensorSpec(threshold=0.5).required() == ("analogue_sensors",)
    assert SensorSpec(hysteresis=0.1).required() == ("analogue_sensors",)


def test_what_the_settings_do_not_need_is_not_there() -> None:
    assert stages_of(SensorSpec()) == []


@pytest.mark.parametrize(
    "settings",
    [
        {"false_positive": 1.1},
        {"false_negative": -0.1},
        {"latency_ticks": -1},
        {"debounce_ticks": 0},
        {"threshold": 0.0},
        {"threshold": 1.1},
        {"hysteresis": -0.1},
        {"hysteresis": 1.0},  # it would go off at a level below 0
        {"threshold": 0.9, "hysteresis": 0.3},  # and on at one beyond 1
        {"level": 0.5},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(settings))):
        SensorSpec.model_validate(settings)
