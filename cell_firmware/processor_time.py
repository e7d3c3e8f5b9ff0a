"""Processor time that a cell's board would need on an MC68HC11, in cycles of its E clock a control period.

The emulation takes no time for it. A scene whose boards need more than a period is one that no MC68HC11 could run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from cell_firmware.effects.serial.timing import E_CLOCK_NS

if TYPE_CHECKING:
    from cell_firmware.build import MotorFacts
    from cell_firmware.effects.registry import CellEffects

LOOP_E: Final = (1312, 2274)
"""Interrupt of the integer speed loop for both wheels, unrolled: no wheel saturated at the least, both at the most."""
EDGE_E: Final = 41
"""Interrupt of an encoder's edge on input capture."""
PULSE_E: Final = 100
"""Output compare of two channels, a pulse period."""
BYTE_E: Final = 80
"""Interrupt of a byte sent or received, a ring of 16 at its end."""


class ProcessorShare(NamedTuple):
    """Processor time of one activity, E cycles a period.

    Attributes:
        what: Description of the activity.
        least: Least time.
        most: Most time.
    """

    what: str
    least: float
    most: float


def period_e(period_ns: int) -> float:
    """E cycles of a control period."""
    return period_ns / E_CLOCK_NS


def shares(
    effects: CellEffects, motors: MotorFacts | None, period_ns: int, sides: int
) -> tuple[ProcessorShare, ...]:
    """Return the processor time of all activities on the board of the cell with the most neighbours.

    Args:
        effects: Effects of the cells.
        motors: Motor parameters; None where wheels run at the commanded speed.
        period_ns: The control period.
        sides: Neighbours with which this cell exchanges messages; 0: none.
    """
    found: list[ProcessorShare] = []
    if motors is not None and effects.fixed_point is not None:
        found.append(ProcessorShare("speed loops", *map(float, LOOP_E)))
    if motors is not None and effects.encoder is not None and effects.encoder.decoder is None:
        a_count_m = effects.encoder.m_per_count(motors.wheel_radius_m)
        counts = motors.free_speed_m_s * period_ns * 1e-9 / a_count_m
        found.append(
            ProcessorShare(
                f"{counts:.0f} edges of the second wheel's encoder at top speed", *[EDGE_E * counts] * 2
            )
        )
    if motors is not None and effects.pwm is not None:
        pulses = period_e(period_ns) / effects.pwm.counts
        found.append(ProcessorShare("PWM", *[PULSE_E * pulses] * 2))
    serial = effects.serial
    if serial is not None and sides:
        lines = 2 * (1 if serial.sharing == "mux" else sides)
        settings = serial.settings(period_ns)
        each = settings.polled_bytes if settings.polled else period_ns / settings.byte_ns
        found.append(
            ProcessorShare(
                f"serial bytes at {serial.baud:,} baud with {lines} lines busy", *[BYTE_E * lines * each] * 2
            )
        )
    return tuple(found)
