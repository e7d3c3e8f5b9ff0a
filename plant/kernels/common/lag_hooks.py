"""Hooks for wheels that lag behind their motors (effect ``wheel_load``), where events are searched.

By default wheels run as their motors have them. ``loaded_wheels`` implements the hooks for a ``work`` with ``slowing``.
"""

from __future__ import annotations

from plant.kernels.common.hooks import implements


def with_lag(work, cell, axis, speed):
    """Add to a ``speed`` of a wheel, or to its slip, by how much the wheel now runs faster than its motor has it."""


def with_lag_begun(work, cell, axis, speed):
    """As ``with_lag``, where the step began."""


def with_lag_rate(work, cell, axis, rate):
    """Add to the ``rate`` of a wheel's speed by how much faster its lag changes, m/s^2."""


def add_lag(work, cell, axis, order, g):
    """Add the series of a wheel's lag along the step to ``g``, that of its speed or slip."""


def lag_sway(work, cell, axis):
    """Bound, m/s, on how far a wheel's lag departs from its start within the step."""


@implements(with_lag, "slowing", own=False)
def _as_driven(_work, _cell, _axis, speed):
    return speed


@implements(with_lag_begun, "slowing", own=False)
def _as_driven_then(_work, _cell, _axis, speed):
    return speed


@implements(with_lag_rate, "slowing", own=False)
def _as_the_motor_does(_work, _cell, _axis, rate):
    return rate


@implements(add_lag, "slowing", own=False)
def _no_lag(_work, _cell, _axis, _order, _g):
    return


@implements(lag_sway, "slowing", own=False)
def _no_sway(_work, _cell, _axis):
    return 0.0
