"""Presence sensors that err and lag: what cells see, against what is there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import binom

from cell_firmware.effects.sensor import SensorSpec
from cell_firmware.effects.stage import Site, Stage
from cell_firmware.firmware import Inputs

Bools = NDArray[np.bool_]
CELLS, SENSORS, TICKS = 900, 3, 40
ALL = slice(None)


def stages_of(spec: SensorSpec, seed: int = 5) -> list[Stage]:
    return list(spec.stages(Site(np.arange(CELLS), SENSORS, None, seed)))


def seen(stages: list[Stage], presence: Bools, alive: NDArray[np.int64] | slice = ALL) -> Bools:
    """What cells see, ``(ticks, n, sensors)``, of what is there."""
    read: list[Bools] = []
    for tick, there in enumerate(presence):
        inputs = Inputs(there)
        for stage in stages:
            inputs = stage.apply(tick, inputs, alive)
        read.append(inputs.presence)
    return np.array(read)


@pytest.fixture(scope="module")
def there() -> Bools:
    return np.random.default_rng(1).random((TICKS, CELLS, SENSORS)) < 0.4


def within(count: int, of: int, probability: float) -> bool:
    """Whether a count is between the binomial's quantiles of 1e-4 on either side."""
    return bool(binom.ppf(1e-4, of, probability) <= count <= binom.ppf(1 - 1e-4, of, probability))


def test_sensors_err_as_often_as_asked_either_way_and_that_is_counted(there: Bools) -> None:
    (errors,) = stages_of(SensorSpec(false_positive=0.01, false_negative=0.2))
    wrong = seen([errors], there) ^ there
    positives, negatives = int((wrong & ~there).sum()), int((wrong & there).sum())
    assert within(positives, int((~there).sum()), 0.01)
    assert within(negatives, int(there.sum()), 0.2)
    assert errors.counted == {"false_positives": positives, "false_negatives": negatives}


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
    assert errors.counted["false_negatives"] == wrong[:, alive].sum()


def test_another_seed_makes_other_errors(there: Bools) -> None:
    spec = SensorSpec(false_positive=0.1)
    assert (seen(stages_of(spec, 1), there) != seen(stages_of(spec, 2), there)).any()


def test_what_the_settings_do_not_need_is_not_there() -> None:
    assert stages_of(SensorSpec()) == []


@pytest.mark.parametrize(
    "settings", [{"false_positive": 1.1}, {"false_negative": -0.1}, {"latency_ticks": -1}, {"threshold": 1}]
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(settings))):
        SensorSpec.model_validate(settings)
