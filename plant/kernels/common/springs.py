"""Hooks for spring and edge effects: stiffness, height and partial coverage of the cells under a parcel.

The default implementations here hold for equal springs at one height under wheels without width. They return constants,
which the compiler folds away. ``uneven_springs`` implements the hooks for surfaces with ``springs``, ``wheel_edges``
for surfaces with ``edges``.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.hooks import implements
from plant.kernels.common.step_end import rollers_under
from plant.kernels.common.surface import Surface

LOAD_ZERO = 1e-12
"""A share of the mean load that rounding can't tell from none."""


def springs_under(surface, i):
    """The springs as parcel ``i`` feels them."""


def edges_under(surface, i):
    """The wheels' edges as they are under parcel ``i``."""


def stiction_under(surface, i):
    """How the wheels hold parcel ``i``."""


def transfer_under(surface, i):
    """The shift of parcel ``i``'s loads."""


def shift(surface, m):
    """The load's centre from the centre of mass (x, y), in mode m, m."""


def unshift(surface, m):
    """Take the load's centre in mode m for the centre of mass. Returns whether it was another."""


def shift_alike(surface, m, other):
    """Take the load's centre in mode m to be where it is in the ``other``."""


def foreseen(surface):
    """Whether the loads along a step are linear in the pose as long as the supports stand."""


def rate(surface, cell):
    """Rate of a cell's spring over the mean one's."""


def gap(surface, cell):
    """How far below the mean level a cell's spring ends, over the sag of one mean spring under the whole parcel."""


def note_gaps(surface, parcel, seg, mark):
    """Keep what the active supports' gaps add to the springs' plane; ``seg`` has their centroid."""


def plane_at(surface, seg, mx, my):
    """The springs' plane with the load's centre at (mx, my) from the centroid of the supports (eqs. 3-13).

    Returns (a, bx, by): the load share of a cell at r from the centroid is its stiffness times
    ``a + b . r`` less its gap.
    """


def negligible(surface, a0):
    """How far from a plane ``a0`` at the centroid a spring may end that rounding can't tell from touching it."""


def reach(surface):
    """How far outside the footprint a cell's centre may lie and the cell still be under it, m."""


def inset(surface):
    """How far inside an edge a cell's centre is as the cell comes to be under the parcel, m: ``reach`` outside."""


def spread(surface, normal):
    """How far outside the footprint, also beyond its corners, a cell's centre may lie and the cell be under it, m."""


def touches(surface, parcel, slot, c, s):
    """Whether the cell in ``parcel.mem[slot]`` is under the parcel by more than nothing; keeps by how much.

    ``c`` and ``s`` are cosine and sine of the parcel's angle.
    """


def weigh(surface, parcel, h):
    """Find how much of each cell on the list is under the parcel where its velocity leads in ``h`` seconds."""


def ramps(surface, parcel):
    """Whether the share of some cell on the list changes with the pose."""


def ramp_ends(surface, parcel, work, order, centre, lever, end, count):
    """Find where a cell's share of the load begins or ceases to ramp, in the step's series.

    ``centre`` and ``lever`` are those of ``events.bend``. Returns (how many events there are, the time up to which
    others are looked for).
    """


def overlap(surface, slot):
    """Which share of the cell in ``parcel.mem[slot]`` is under the parcel."""


def smooth(surface):
    """Whether a parcel's loads change without a jump where a cell comes to be under it."""


@kernel
def surface_under(surface, i):
    """The surface as parcel ``i`` feels it."""
    springs, edges, rollers = springs_under(surface, i), edges_under(surface, i), rollers_under(surface, i)
    return Surface(
        surface.pos,
        surface.grid,
        surface.steady,
        surface.decay,
        surface.grip,
        springs,
        edges,
        rollers,
        surface.drag,
        stiction_under(surface, i),
        surface.factors,
        transfer_under(surface, i),
    )


@kernel
def stiffness(surface, cell, slot):
    """Stiffness of a cell, which is in ``parcel.mem[slot]``, over that of a mean one wholly under the parcel."""
    return rate(surface, cell) * overlap(surface, slot)


@implements(springs_under, "springs", own=False)
def _no_springs(_surface, _i):
    return None


@implements(edges_under, "edges", own=False)
def _no_edges(_surface, _i):
    return None


@implements(stiction_under, "stiction", own=False)
def _no_stiction(_surface, _i):
    return None


@implements(transfer_under, "transfer", own=False)
def _no_transfer(_surface, _i):
    return None


@implements(shift, "transfer", own=False)
def _none(_surface, _m):
    return 0.0, 0.0


@implements(unshift, "transfer", own=False)
def _never_another(_surface, _m):
    return False


@implements(shift_alike, "transfer", own=False)
def _all_alike(_surface, _m, _other):
    return


@implements(foreseen, "transfer", "edges", own=False)
def _by_supports(_surface):
    return True


@implements(foreseen, "transfer", "edges", own=True)
def _found_afresh(_surface):
    return False


@implements(rate, "springs", own=False)
def _mean_rate(_surface, _cell):
    return 1.0


@implements(gap, "springs", own=False)
def _level(_surface, _cell):
    return 0.0


@implements(note_gaps, "springs", own=False)
def _no_gaps(_surface, _parcel, _seg, _mark):
    return


@implements(plane_at, "springs", own=False)
def _plane(_surface, seg, mx, my):
    bx, by = seg[at.PXX] * mx + seg[at.PXY] * my, seg[at.PXY] * mx + seg[at.PYY] * my
    return 1.0 / seg[at.N_ACTIVE], bx, by


@implements(negligible, "springs", own=False)
def _of_the_mean(_surface, a0):
    return LOAD_ZERO * a0


@implements(reach, "edges", own=False)
def _centre_only(_surface):
    return 0.0


@implements(inset, "edges", own=False)
def _on_the_edge(_surface):
    return 0.0


@implements(spread, "edges", own=False)
def _no_farther(_surface, _normal):
    return 0.0


@implements(weigh, "edges", own=False)
def _all_whole(_surface, _parcel, _h):
    return


@implements(ramps, "edges", own=False)
def _stands(_surface, _parcel):
    return False


@implements(ramp_ends, "edges", own=False)
def _no_ramps(_surface, _parcel, _work, _order, _centre, _lever, end, count):
    return count, end


@implements(touches, "edges", own=False)
def _always(_surface, _parcel, _slot, _c, _s):
    return True


@implements(overlap, "edges", own=False)
def _whole(_surface, _slot):
    return 1.0


@implements(smooth, "edges", own=False)
def _jumps(_surface):
    return False
