"""What is said of a protocol, from what was seen of it and what theory had said."""

from __future__ import annotations

import numpy as np
import pytest

from cell_firmware.program import Theory
from deploy.protocol_report.report import ratio, residual_history, verdict
from deploy.protocol_report.residuals import ERROR, Residuals, fit_rate

ALL = np.ones(1, dtype=np.bool_)


def decaying(factor: float, ticks: int = 400) -> Residuals:
    residuals = Residuals(np.zeros((1, 1)))
    for tick in range(ticks):
        residuals.take(tick, np.array([[factor**tick]]), ALL)
    return residuals


def said(measured: float, predicted: float, *reasons: str) -> str:
    residuals = decaying(measured)
    rate = fit_rate(np.array(residuals.tick), np.array(residuals.rms[ERROR]), np.array(residuals.scale))
    return verdict(Theory("a law", factor=predicted), residuals, rate, reasons, 0)


def test_rates_are_compared_by_their_logarithms() -> None:
    assert "the rates agree within 0.01 %" in said(0.98, 0.98)
    assert "the rates agree within 4 %" in said(0.98**1.04, 0.98)
    assert "0.5 times as fast as predicted, which theory does not cover here: effect link_loss." in said(
        0.98**0.5, 0.98, "effect link_loss"
    )
    assert "0.5 times as fast as predicted." in said(0.98**0.5, 0.98)
    assert "the residual does not decay." in said(1.01, 0.98)
    assert "2 times as fast, as in a run with little of that error" in said(0.98**2, 0.98)
    assert "the field grows 1.5 times as fast" in said(1.02**1.5, 1.02)


def test_what_stays_as_it_is_agrees_by_its_factor() -> None:
    assert said(1.0, 1.0).endswith("Theory predicts 1: the measured rate agrees.")
    assert "the measured rate does not agree" in said(0.98, 1.0)


def test_a_ratio_is_of_rates_that_are_some() -> None:
    residuals = decaying(0.98)
    rate = fit_rate(np.array(residuals.tick), np.array(residuals.rms[ERROR]), np.array(residuals.scale))
    assert ratio(rate, 0.98**2) == pytest.approx(0.5)
    assert ratio(rate, 1.0) is ratio(rate, None) is ratio(None, 0.5) is ratio(rate, 0.0) is None


def counting(until: int, ticks: int = 40) -> Residuals:
    """A field that counts up until a tick and then stays."""
    residuals = Residuals(None)
    for tick in range(ticks):
        residuals.take(tick, np.array([[float(min(tick, until))]]), ALL)
    return residuals


def test_a_protocol_that_is_done_after_some_ticks_is_held_against_their_number() -> None:
    theory = Theory("a law", ticks=18)
    fact = "The field last changed in tick 17; theory: done after 18 ticks"
    assert verdict(theory, counting(17), None, (), 0) == f"{fact}. This agrees with theory."
    late = verdict(theory, counting(25), None, ("2 cells died",), 30)
    assert late.endswith("this is longer than predicted, which theory does not cover here: 2 cells died.")
    healed = verdict(theory, counting(25), None, ("2 cells died",), 10)
    assert "in tick 25, 15 after the last cell died; " in healed
    assert healed.endswith("counted again from every death. This agrees with theory.")
    assert "still changed in the last tick, 39" in verdict(theory, counting(50), None, (), 0)


def test_without_theory_or_numbers_that_is_said() -> None:
    residuals = decaying(0.9, ticks=3)
    assert verdict(None, residuals, None, (), 0).endswith("Theory predicts no rate here.")
    assert "too few ticks" in verdict(Theory("", factor=0.5), residuals, None, (), 0)
    assert "never changed" in verdict(Theory("", factor=0.5), counting(0), None, (), 0)
    assert verdict(None, Residuals(None), None, (), 0) == "No values of the field were received."


def test_a_residual_has_settled_from_where_it_stays_small() -> None:
    rms = [np.nan, 2.0, 0.01, 0.5, 0.02, 1e-6, 1e-7]
    found = residual_history(range(0, 70, 10), rms, [2 * one for one in rms])
    assert found is not None
    assert (found.first_rms, found.greatest_rms, found.last_rms, found.last_max) == (2.0, 2.0, 1e-7, 2e-7)
    assert (found.settled_1_percent_tick, found.settled_1e6_tick) == (40, 50)
    unsettled = residual_history([0, 1], [0.5, 1.0], [1.0, 1.0])
    assert unsettled is not None
    assert unsettled.settled_1_percent_tick is None
    assert residual_history([0], [np.nan], [np.nan]) is None
