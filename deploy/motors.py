"""What the cells' boards are told of the plant's motors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cell_firmware.assembly import Motors

if TYPE_CHECKING:
    from plant.effects.motors import MotorsSpec


def told(motors: MotorsSpec | None) -> Motors | None:
    """What a board must know of a scene's motors; None where there are none."""
    if motors is None:
        return None
    return Motors(motors.supply_v, motors.supply_v * motors.speed_per_volt_m_s)
