"""The converter of analogue sensors: codes by hand, noise against its own distribution."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import kstest

from bus.random_streams import CounterStream
from cell_firmware.effects.adc import AdcSpec
from cell_firmware.effects.base import ShardContext
from cell_firmware.firmware import Inputs

Floats = NDArray[np.float64]
CELLS, SENSORS = 2000, 2


def read(spec: AdcSpec, level: Floats, tick: int = 0, cells: NDArray[np.int64] | None = None) -> Floats:
    """What the cells see of a level, all of it 8-bit codes over 256."""
    cells = np.arange(len(level)) if cells is None else cells
    (stage,) = spec.input_filters(ShardContext(cells, level.shape[1], None, 7, levels=True))
    inputs = Inputs(np.zeros(level.shape, dtype=np.bool_), None, None, level)
    seen = stage.apply(tick, inputs, slice(None)).level
    assert seen is not None
    assert np.array_equal(seen * 256, np.round(seen * 256))
    return seen


def test_a_code_is_the_level_in_256ths_rounded_down_and_at_most_255() -> None:
    level = np.array(
        [[0.0, 1.0 / 256], [np.nextafter(1.0 / 256, 0.0), 0.5], [255.0 / 256, 1.0], [0.9999, 0.3]]
    )
    codes = read(AdcSpec(), level) * 256
    assert codes.tolist() == [[0.0, 1.0], [0.0, 128.0], [255.0, 255.0], [255.0, 76.0]]


def test_noise_has_the_requested_rms_and_the_distribution_of_four_uniforms() -> None:
    spec, noise = AdcSpec(noise_codes=8.0), []
    for tick in range(10):
        # a level in the middle of a code: rounding down adds a uniform half a code either way
        seen = read(spec, np.full((CELLS, SENSORS), 128.5 / 256), tick)
        noise.append(seen * 256 - 128.0)
    found = np.concatenate(noise).ravel()
    n = len(found)
    assert found.mean() == pytest.approx(0.0, abs=5 * 8.0 / np.sqrt(n))
    # variances add: the noise's, and a twelfth of rounding; its kurtosis is -0.3
    assert found.var() == pytest.approx(64.0 + 1.0 / 12.0, rel=5 * np.sqrt(1.7 / n))
    assert np.abs(found).max() <= 8.0 * 12.0**0.5 + 0.5
    uniform = np.random.default_rng(2).random((n, 4)).sum(axis=1)
    wanted = 8.0 * np.sqrt(3.0) * (uniform - 2.0)
    assert kstest(found + np.random.default_rng(3).random(n) - 0.5, np.sort(wanted)).pvalue > 1e-4


def test_noise_goes_below_no_code_and_beyond_none() -> None:
    spec = AdcSpec(noise_codes=40.0)
    for exact, code in ((0.0, 0.0), (1.0, 255.0)):
        codes = read(spec, np.full((CELLS, SENSORS), exact)) * 256
        assert 0.0 <= codes.min() < codes.max() <= 255.0
        assert 0.4 < np.mean(codes == code) < 0.6


def test_readings_of_ticks_cells_and_sensors_have_noise_of_their_own() -> None:
    spec = AdcSpec(noise_codes=8.0)
    level = np.full((CELLS, SENSORS), 0.5)
    first, second = (read(spec, level, tick) - 0.5 for tick in (0, 1))
    pairs = ((first, second), (first[1:], first[:-1]), (first[:, 0], first[:, 1]))
    for one, other in pairs:
        correlation = np.corrcoef(one.ravel(), other.ravel())[0, 1]
        assert abs(correlation) < 5.0 / np.sqrt(one.size)


def test_a_cell_s_noise_does_not_depend_on_who_is_read_with_it() -> None:
    spec, level = AdcSpec(noise_codes=3.0), np.random.default_rng(4).random((40, SENSORS))
    together = read(spec, level, 5)
    for cell in (0, 7, 39):
        alone = read(spec, level[[cell]], 5, np.array([cell]))
        assert alone.tobytes() == together[[cell]].tobytes()


def test_no_noise_draws_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(*_: object) -> None:
        raise AssertionError("drawn")

    monkeypatch.setattr(CounterStream, "uniform", drawn)
    read(AdcSpec(), np.full((3, 1), 0.5))


@pytest.mark.parametrize("settings", [{"noise_codes": -1.0}, {"noise_codes": float("inf")}, {"bits": 8}])
def test_settings_that_make_no_sense_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(settings))):
        AdcSpec.model_validate(settings)
