"""Hooks of the effect ``wheel_load`` in the implicit solver's kernels.

The defaults do nothing: wheels run as their motors drive them, whatever the load. ``loaded_wheels`` implements the
hooks for a ``work`` with ``slowing``, which holds the speed loss of each wheel.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common.hooks import implements


def speed(work, surface, cell, e):
    """Surface speed of a cell's wheels now (vx, vy), ``e`` being the motors' decay factor."""


def begun(work, surface, cell, e):
    """Return the wheels' surface speed (vx, vy) at the stored start of the step; ``e`` is the decay factor then."""


def lightness(work):
    """The parcel's mass over that of a wheel as the surface feels it."""


def recoil(work, cell, axis, impulse):
    """Take from a wheel, per kilogram of the parcel, the impulse that it gives along an axis, m/s."""


def lighten(work, parcel, row, cell, push_x, push_y, h):
    """Let the wheels in ``work.wheels[row]``, that push by as much either way, give way in a step of ``h``."""


def slip_left(work, row, w, axis):
    """Slip, m/s, that a row's force leaves of a wheel at the velocity ``w``."""


def own_rates(work, parcel, row, wheel):
    """Have the ``wheel`` in the row give way in a problem whose unknowns are accelerations, before its G is changed."""


def note_lags(work, parcel, rows):
    """Keep how fast wheels' speeds change, the first ``rows`` of ``work.wheels`` pulling as in the problem just solved.

    Its unknowns are accelerations.
    """


def begin_lags(work):
    """Have that which ``note_lags`` kept hold where a step begins."""


def expand_lags(work, h):
    """Expand the wheels' motion over the step just taken into series."""


def note_lag_slopes(work, first, h):
    """Keep how fast the wheels' speeds change at unit time ``first`` of the step of ``h``."""


def carry_lags(work, dt):
    """Move the wheels on by ``dt`` seconds as they run at the event of the step."""


def slow(work, parcel, rows, h):
    """Take the wheels through the step of ``h`` just solved, the first ``rows`` of ``work.wheels`` pulling."""


def keep(work):
    """Keep how the wheels run where a step begins."""


def take_back(work):
    """Have the wheels run as they did where the step began."""


def tabulate(work, row):
    """Keep how the wheels run after a step in ``row + 1`` parts."""


def extrapolate(work, lasts):
    """Have the wheels run as the tabulated results lead to. Returns the error, m; speeds count ``lasts`` times."""


def full(work):
    """Whether there may be no room to hand over the wheels of one more parcel."""


def hand_over(work, parcel, left):
    """List what the parcel has changed of the wheels, by ``left`` seconds after it ended, and forget it."""


@kernel
def unloaded(surface, cell, e):
    """Surface speed of a cell's wheels as the motors have it (vx, vy)."""
    vx = surface.steady[cell, 0] + e * surface.decay[cell, 0]
    vy = surface.steady[cell, 1] + e * surface.decay[cell, 1]
    return vx, vy


@kernel
def summed(surface, cell, e):
    """Size of the terms of ``unloaded``, both axes together, m/s."""
    steady = abs(surface.steady[cell, 0]) + abs(surface.steady[cell, 1])
    return steady + e * (abs(surface.decay[cell, 0]) + abs(surface.decay[cell, 1]))


@implements(lighten, "slowing", own=False)
def _stiff(_work, _parcel, _row, _cell, _push_x, _push_y, _h):
    return


@implements(slip_left, "slowing", own=False)
def _of_the_motors_speed(_work, row, w, axis):
    return row[im.SX + axis] - w[axis] - row[im.AX + axis] * w[2]


@implements(own_rates, "slowing", own=False)
def _as_driven(_work, _parcel, _row, _wheel):
    return


@implements(note_lags, "slowing", own=False)
def _none_to_note(_work, _parcel, _rows):
    return


@implements(begin_lags, "slowing", own=False)
def _none_to_begin(_work):
    return


@implements(expand_lags, "slowing", own=False)
def _none_to_expand(_work, _h):
    return


@implements(note_lag_slopes, "slowing", own=False)
def _no_slopes(_work, _first, _h):
    return


@implements(carry_lags, "slowing", own=False)
def _none_to_carry(_work, _dt):
    return


@implements(slow, "slowing", own=False)
def _unmoved(_work, _parcel, _rows, _h):
    return


@implements(keep, "slowing", own=False)
def _nothing_to_keep(_work):
    return


@implements(take_back, "slowing", own=False)
def _nothing_to_take_back(_work):
    return


@implements(tabulate, "slowing", own=False)
def _nothing_to_tabulate(_work, _row):
    return


@implements(extrapolate, "slowing", own=False)
def _right(_work, _lasts):
    return 0.0


@implements(full, "slowing", own=False)
def _roomy(_work):
    return False


@implements(hand_over, "slowing", own=False)
def _no_events(_work, _parcel, _left):
    return


@implements(speed, "slowing", own=False)
def _of_the_motor(_work, surface, cell, e):
    return unloaded(surface, cell, e)


@implements(begun, "slowing", own=False)
def _of_the_motor_then(_work, surface, cell, e):
    return unloaded(surface, cell, e)


@implements(lightness, "slowing", own=False)
def _heavy(_work):
    return 0.0


@implements(recoil, "slowing", own=False)
def _unshaken(_work, _cell, _axis, _impulse):
    return
