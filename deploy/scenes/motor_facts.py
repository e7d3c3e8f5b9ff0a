"""Facts about the plant's motors for the cells' boards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cell_firmware.build import MotorFacts

if TYPE_CHECKING:
    from plant.effects.motors import MotorsSpec


def motor_facts(motors: MotorsSpec | None) -> MotorFacts | None:
    """Return the facts about a scene's motors that boards need; None without motors."""
    if motors is None:
        return None
    free_speed_m_s = motors.supply_v * motors.first_order.speed_per_volt_m_s
    return MotorFacts(
        motors.supply_v, free_speed_m_s, None if motors.dc is None else motors.dc.wheel_radius_m
    )
