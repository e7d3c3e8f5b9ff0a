"""Protocol report: measured convergence compared with theory, as numbers and as a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, log
from typing import TYPE_CHECKING, Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.protocol_report.residuals import CHANGE, DISAGREEMENT, ERROR, Rate, Residuals
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from cell_firmware.program import Theory
    from deploy.scenes.scene import Scene


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkLoad:
    """Messages between the cells of a run.

    Attributes:
        sent: Messages that programs gave to a line with a neighbour at its end.
        received: Messages that they received.
        sent_per_cell_tick: Sent by a living cell in a tick, to all its sides together.
        received_per_cell_tick: Likewise.
        message_bytes: A message's fields, packed.
        line_bytes: What it takes on a serial line: with its check byte.
        line_bytes_per_cell_tick: What a cell gives its lines in a tick, if all of it goes.
        on_lines: Whether the scene has serial lines; otherwise this is what they would have to carry.
        baud: Of those lines.
        line_capacity_bytes_per_tick: What one direction of a line between two cells carries in a tick.
        line_load: Bytes given to a direction of a line, by what it carries: above 1 not every message goes out.
    """

    sent: int
    received: int
    sent_per_cell_tick: float
    received_per_cell_tick: float
    message_bytes: int
    line_bytes: int
    line_bytes_per_cell_tick: float
    on_lines: bool
    baud: int
    line_capacity_bytes_per_tick: float
    line_load: float


def link_load(
    scene: Scene,
    message: np.dtype[np.void] | None,
    counters: Mapping[str, int],
    cell_ticks: int,
    link_ticks: int,
) -> LinkLoad | None:
    """Compute the load of a run's messages; None for firmware without messages, or a run of no ticks.

    Args:
        scene: Scene of the run.
        message: Type of its messages.
        counters: Counters of its cells.
        cell_ticks: Sum over cells of the ticks in which the cell was alive.
        link_ticks: Sum over directed links of the ticks in which the sender was alive.
    """
    if message is None or not cell_ticks:
        return None
    from cell_firmware.effects.serial.framing import bytes_of
    from cell_firmware.effects.serial.spec import SerialSpec

    lines = scene.effects.serial or SerialSpec()
    settings = lines.settings(scene.cells.period_ns)
    capacity = scene.tick_ns / settings.byte_ns
    if settings.polled:
        capacity = min(capacity, settings.polled_bytes * scene.tick_ns / settings.period_ns)
    if settings.dwell_periods is not None:
        capacity /= 4  # one SCI for four sides
    sent, received = counters.get("messages.sent", 0), counters.get("messages.received", 0)
    size = bytes_of(message)
    return LinkLoad(
        sent=sent,
        received=received,
        sent_per_cell_tick=sent / cell_ticks,
        received_per_cell_tick=received / cell_ticks,
        message_bytes=size - 1,
        line_bytes=size,
        line_bytes_per_cell_tick=sent * size / cell_ticks,
        on_lines=scene.effects.serial is not None,
        baud=lines.baud,
        line_capacity_bytes_per_tick=capacity,
        line_load=sent * size / link_ticks / capacity if link_ticks else 0.0,
    )


CSV, PICTURE = "protocol.csv", "protocol.png"
_AGREES: Final = 0.05
"""A rate within this much of theory's agrees with it."""
_STEADY: Final = 1e-6
"""A factor within this much of 1 stays as it is."""
_DISTURBS: Final = ("link_loss", "link_delay", "serial", "clock", "cop", "sensor")
"""Effects that theory leaves out."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualHistory:
    """History of a residual.

    Attributes:
        first_rms: First known root mean square.
        greatest_rms: Greatest root mean square of the run.
        last_rms: Root mean square in the last tick.
        last_max: Greatest residual in the last tick.
        settled_1_percent_tick: Tick from which the root mean square stays within 1 % of the greatest; None if it
            doesn't.
        settled_1e6_tick: Tick from which the root mean square stays within 1e-6 of the greatest; None if it doesn't.
    """

    first_rms: float
    greatest_rms: float
    last_rms: float
    last_max: float
    settled_1_percent_tick: int | None
    settled_1e6_tick: int | None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ProtocolReport:
    """Report of a protocol's run, compared with theory.

    Attributes:
        observed: Its field: a variable of the program, or ``drive`` where the program names none.
        every_ticks: Ticks from one sample to the next.
        ticks: How often it was.
        cells: That there were at the start.
        cells_dead: That died.
        law: What theory says; None if it says nothing.
        predicted_factor: By which the slowest error shrinks a tick, by theory.
        predicted_ticks: In which it is done, by theory.
        residuals: By name, ``change``, ``error``, ``disagreement``: what became of each.
        rate_of: Whose rate was fitted.
        rate: The fit, up to the first death, or after the last where that is too little; None if there is no more.
        rate_ratio: The fitted rate (minus the factor's logarithm) by theory's; None without both, or if that stays.
        last_change_tick: In which the field last changed.
        verdict: In a sentence, whether it does what theory says.
        notes: What else to know, a line each.
        links: What its messages took; None if it sends none.
    """

    observed: str
    every_ticks: int
    ticks: int
    cells: int
    cells_dead: int
    law: str | None
    predicted_factor: float | None
    predicted_ticks: int | None
    residuals: Mapping[str, ResidualHistory]
    rate_of: str | None
    rate: Rate | None
    rate_ratio: float | None
    last_change_tick: int
    verdict: str
    notes: tuple[str, ...]
    links: LinkLoad | None


def residual_history(
    tick: Sequence[int], rms: Sequence[float], most: Sequence[float]
) -> ResidualHistory | None:
    """Summarise a residual's history; None if no value was finite."""
    sizes = np.asarray(rms, dtype=np.float64)
    known: NDArray[np.int64] = np.flatnonzero(np.isfinite(sizes))
    if not len(known):
        return None
    sizes = sizes[known]
    greatest = float(sizes.max())
    ticks: NDArray[np.int64] = np.asarray(tick, dtype=np.int64)[known]

    def settled(part: float) -> int | None:
        over: NDArray[np.int64] = np.flatnonzero(sizes > part * greatest)
        after = int(over[-1]) + 1 if len(over) else 0
        return int(ticks[after]) if after < len(ticks) else None

    return ResidualHistory(
        first_rms=float(sizes[0]),
        greatest_rms=greatest,
        last_rms=float(sizes[-1]),
        last_max=float(np.asarray(most, dtype=np.float64)[known][-1]),
        settled_1_percent_tick=settled(1e-2),
        settled_1e6_tick=settled(1e-6),
    )


def dominant_residual(residuals: Residuals) -> str:
    """Name the residual that the rate is fitted to: disagreement if known, else error, else change."""
    return next(name for name in (DISAGREEMENT, ERROR, CHANGE) if name in residuals.rms)


def ratio(rate: Rate | None, predicted: float | None) -> float | None:
    """The measured rate by theory's; None without both, or where one of them is no rate."""
    if rate is None or predicted is None or predicted <= 0.0 or abs(predicted - 1.0) < _STEADY:
        return None
    return log(rate.factor) / log(predicted) if rate.factor > 0.0 else None


def verdict(
    theory: Theory | None, residuals: Residuals, rate: Rate | None, reasons: Sequence[str], last_death: int
) -> str:
    """Whether a protocol did what theory says, in a sentence.

    Args:
        theory: What it says; None if nothing.
        residuals: What was seen.
        rate: What was fitted.
        reasons: Why the run may differ from what theory is for.
        last_death: The tick in which the last cell died that did; 0 if none.
    """
    if not len(residuals.tick):
        return "No values of the field were received."
    if theory is not None and theory.ticks is not None:
        return _done(theory.ticks, residuals, reasons, last_death)
    if theory is None or theory.factor is None:
        return f"{_measured(rate)} Theory predicts no rate here."
    if rate is None:
        return f"Theory predicts a factor of {theory.factor:.6g} a tick; {_too_little(residuals)}"
    return f"{_measured(rate)} {_compared(rate, theory.factor, reasons)}"


def _done(bound: int, residuals: Residuals, reasons: Sequence[str], last_death: int) -> str:
    """Of a protocol that is done after some ticks, or was not."""
    last, end = residuals.moved, residuals.tick[-1]
    since = f", {last - last_death} after the last cell died" if 0 < last_death <= last else ""
    says = f"theory: done after {plural(bound, 'tick')}"
    if last >= end:
        return f"The field still changed in the last tick, {last}; {says}{_but(reasons)}."
    fact = f"The field last changed in tick {last}{since}; {says}"
    if last <= bound:
        return f"{fact}. This agrees with theory."
    if since and last - last_death <= bound:
        return f"{fact}, counted again from every death. This agrees with theory."
    return f"{fact}: this is longer than predicted{_but(reasons)}."


def _measured(rate: Rate | None) -> str:
    if rate is None:
        return "There are too few values to fit a rate."
    spread = "" if f"{rate.low:.6g}" == f"{rate.high:.6g}" else f" ({rate.low:.6g} to {rate.high:.6g})"
    slow = rate.ticks_per_decade
    decade = f", a tenth every {slow:.4g} ticks" if slow is not None and isfinite(slow) and slow < 1e6 else ""
    stops = "" if rate.floor is None else f", down to {rate.floor:.2g}, where it stops"
    return f"A factor of {rate.factor:.6g}{spread} a tick was measured{decade}{stops}."


def _compared(rate: Rate, predicted: float, reasons: Sequence[str]) -> str:
    """Of a protocol that comes ever closer, stays as it is, or runs away."""
    says = f"Theory predicts {predicted:.6g}"
    times = ratio(rate, predicted)
    if times is None:
        near = abs(rate.factor - predicted) < 1e-3
        return f"{says}: {'the measured rate agrees' if near else f'the measured rate does not agree{_but(reasons)}'}."
    if abs(times - 1.0) <= _AGREES:
        return f"{says}: the rates agree within {max(100 * abs(times - 1.0), 0.01):.2g} %."
    if predicted > 1.0:
        return f"{says}: the field grows {times:.3g} times as fast{_but(reasons)}."
    if times <= 0.0:
        return f"{says}: the residual does not decay{_but(reasons)}."
    if times > 1.0:
        return (
            f"{says} of the slowest error: {times:.3g} times as fast, as in a run with little of that error."
        )
    return f"{says}: {times:.3g} times as fast as predicted{_but(reasons)}."


def _but(reasons: Sequence[str]) -> str:
    return f", which theory does not cover here: {', '.join(reasons)}" if reasons else ""


def _too_little(residuals: Residuals) -> str:
    quiet = residuals.moved == 0
    return "the field never changed." if quiet else "the run has too few ticks to measure one."


def excluded_effects(scene: Scene, cells_dead: int) -> list[str]:
    """List the disturbances of a run that theory leaves out: effects on cells and links, and deaths."""
    enabled = dict(scene.effects.enabled())
    found = [f"effect {name}" for name in _DISTURBS if name in enabled]
    if scene.bus.link_ticks > 1:
        found.append(f"bus.link_ticks = {scene.bus.link_ticks}")
    if cells_dead:
        found.append(f"{plural(cells_dead, 'cell')} died")
    return found
