"""Hooks of the balance between loads and the traction that shifts them (effect ``load_transfer``).

The defaults compile to nothing: loads don't depend on traction. ``load_transfer`` implements the hooks for surfaces
with ``transfer``.
"""

from __future__ import annotations

from plant.kernels.common import layout as at
from plant.kernels.common.hooks import implements
from plant.kernels.implicit.supports import carry_supports, settle_loads


def hold_supports(surface, parcel, work, h):
    """Loads where the parcel is, on the cells that were under it where the step began. Returns the status.

    ``h`` is how long the part of the step lasts for which they are asked, s.
    """


def begin_balance(surface):
    """Begin a balance at the shift that stands."""


def balance(surface, parcel, work, instant, ax, ay, noise):
    """Shift the loads to where the traction has them that accelerates the parcel by (ax, ay), m/s^2.

    ``instant`` is a tuple: the motors' decay factor, how long the part of the step lasts, s, and the velocity at which
    the wheels listed pull. ``noise`` is the rounding of that acceleration. Returns MOVING where they were there,
    UNBALANCED where the traction is to be found again, TIPPED where no loads balance it, NOT_SOLVED where none were
    found.
    """


@implements(hold_supports, "transfer", "edges", own=False)
def _carry(_surface, parcel, work, _h):
    carry_supports(parcel, work)
    return at.MOVING


@implements(hold_supports, "transfer", "edges", own=True)
def _settle(surface, parcel, work, h):
    return settle_loads(surface, parcel, work, h)


@implements(begin_balance, "transfer", own=False)
def _nothing_to_begin(_surface):
    return


@implements(balance, "transfer", own=False)
def _balanced(_surface, _parcel, _work, _instant, _ax, _ay, _noise):
    return at.MOVING
