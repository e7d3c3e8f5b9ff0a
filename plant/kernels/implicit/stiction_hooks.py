"""Hooks of static friction in the implicit solver's kernels, where it exceeds the kinetic one.

The defaults know one limit of each wheel, whether it sticks or slips. ``stiction`` implements the hooks for surfaces
with ``stiction``, which remembers how each wheel holds the parcel.
"""

from __future__ import annotations

from plant.kernels.common.hooks import implements
from plant.kernels.implicit.step import new_velocity


def find_velocity(surface, parcel, work, count, h, w):
    """Velocity after a step of ``h`` on the ``count`` wheels listed, into ``w``. Returns whether it was found."""


def commit_grips(surface, work, count):
    """Take how the ``count`` wheels of the step just solved hold the parcel at its end."""


def keep_grips(surface, parcel, work, e):
    """Keep how wheels hold the parcel where a step begins; ``e`` is the motors' decay factor then."""


def restore_grips(surface, work):
    """Have wheels hold the parcel as they did where the step began."""


@implements(find_velocity, "stiction", own=False)
def _one_limit(_surface, _parcel, work, count, h, w):
    return new_velocity(work, count, work.law, h, w)


@implements(commit_grips, "stiction", own=False)
def _nothing_to_commit(_surface, _work, _count):
    return


@implements(keep_grips, "stiction", own=False)
def _nothing_to_keep(_surface, _parcel, _work, _e):
    return


@implements(restore_grips, "stiction", own=False)
def _nothing_to_restore(_surface, _work):
    return
