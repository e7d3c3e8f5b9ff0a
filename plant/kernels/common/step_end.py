"""Hooks at the end of a step, for effects that apply impulses to parcels.

The defaults compile to nothing. ``roller_impacts`` implements the hooks for surfaces with ``rollers``.
"""

from __future__ import annotations

from plant.kernels.common.hooks import implements


def rollers_under(surface, i):
    """The wheels' rollers as parcel ``i`` meets them."""


def allowed(surface, parcel, work, now, h):
    """How long a step may be that wants to be ``h``, s."""


def strike(surface, parcel, work, now, h):
    """Push the parcel at the end of a step from ``now``, h s long, with the loads found there; see ``work.begin``."""


@implements(rollers_under, "rollers", own=False)
def _no_rollers(_surface, _i):
    return None


@implements(allowed, "rollers", own=False)
def _any_length(_surface, _parcel, _work, _now, h):
    return h


@implements(strike, "rollers", own=False)
def _nothing_strikes(_surface, _parcel, _work, _now, _h):
    return
