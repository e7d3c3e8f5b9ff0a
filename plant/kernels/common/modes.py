"""The support sets whose motions mix while chatter is captured, and what ends a capture.

A captured group of cells sits on a surface; on one side of it they are under the parcel, on the other they are not
(or the other way round for a cell that leaves as others enter). Each side is a support set of its own, with the loads
that it would have, lifted cells and all: a mode. Motion along the surface is the mixture of the two modes' motions
whose fraction keeps the parcel on it (Filippov). Every further group doubles the modes.
"""

from __future__ import annotations

from math import inf

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.branches import settle_branches
from plant.kernels.common.hooks import implements
from plant.kernels.common.loads import settle_mode
from plant.kernels.common.moments import moments
from plant.kernels.common.motion import accelerations, surfaces
from plant.kernels.common.springs import shift_alike


def gather(work, surface, parcel, m, e, mixes):
    """Sum up mode m for its accelerations, its loads being settled; ``mixes`` where ``mix`` follows."""


def mix(work, surface, parcel, e, c, s):
    """Accelerations along captured surfaces, as ``motion.accelerations``."""


FRACTION_ZERO = 1e-9
"""How far a fraction may lie outside [0, 1] before its group is released."""
SINGULAR = 1e-9
"""Groups whose effects can't be told apart better than this are one too many."""


@kernel
def drop(mem, ctl, i):
    """Take member ``i`` off the list (the last takes its place)."""
    last = ctl[at.N_MEMBERS] - 1
    for k in range(at.MEM_COLUMNS):
        mem[i, k] = mem[last, k]
    ctl[at.N_MEMBERS] = last


@kernel
def put_in(mem, i, group, side):
    """Capture member ``i``: under the parcel on one side of its group's surface only."""
    mem[i, at.GROUP], mem[i, at.SIDE] = group, side
    for m in range(at.MODES):
        if (m & (1 << group) != 0) != (side > 0):
            mem[i, at.MARK + m] = at.ABSENT
        elif mem[i, at.MARK + m] == at.ABSENT:
            mem[i, at.MARK + m] = at.ACTIVE


@kernel
def release(surface, mem, ctl, group, far):
    """End a captured group: its cells are from now on what they were on the far, or the near, side."""
    below, i = (1 << group) - 1, at.ZERO
    while i < ctl[at.N_MEMBERS]:
        side = mem[i, at.SIDE]
        if side != 0 and mem[i, at.GROUP] == group:
            if (side > 0) != far:
                drop(mem, ctl, i)
                continue
            mem[i, at.SIDE] = 0
        elif side != 0 and mem[i, at.GROUP] > group:
            mem[i, at.GROUP] -= 1
        for m in range(at.MODES >> 1):
            # the mode of the same other groups, this one on the side it ends on; never below m, so still unchanged
            source = ((m & ~below) << 1) | (m & below)
            mem[i, at.MARK + m] = mem[i, at.MARK + (source | (1 << group) if far else source)]
        i += 1
    for m in range(at.MODES >> 1):
        source = ((m & ~below) << 1) | (m & below)
        shift_alike(surface, m, source | (1 << group) if far else source)
    ctl[at.N_GROUPS] -= 1


@kernel
def release_inside(surface, mem, ctl, group):
    """End a captured group on the side on which more of its cells are under the parcel."""
    balance = at.ZERO
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.SIDE] != 0 and mem[i, at.GROUP] == group:
            balance += mem[i, at.SIDE]
    release(surface, mem, ctl, group, balance >= 0)


@kernel
def least_share(parcel, work):
    """The smallest fraction of either side over all groups. Returns (fraction, group, is it the near side's)."""
    worst, which, far = 1e300, at.ZERO, at.UNDONE
    for h in range(parcel.ctl[at.N_GROUPS]):
        if work.fraction[h] < worst:
            worst, which, far = work.fraction[h], h, at.UNDONE
        if 1.0 - work.fraction[h] < worst:
            worst, which, far = 1.0 - work.fraction[h], h, at.COMPLETE
    return worst, which, far


@kernel
def grasp(surface, parcel, seg, m, e, mixes):
    """Branches of the law that mode m's wheels are on, its loads being settled, and what its wheels sum to.

    ``mixes`` where ``motion.accelerations`` is to be asked for.
    """
    if parcel.par[at.LIMIT] < inf:
        settle_branches(surface, parcel, seg, m, e)
    moments(surface, parcel, seg, m, e, mixes)


@implements(gather, "law", own=False)
def _gather(work, surface, parcel, m, e, mixes):
    grasp(surface, parcel, work.segs[m], m, e, mixes)


@implements(mix, "law", own=False)
def _mix(work, _surface, parcel, e, c, s):
    return accelerations(parcel, work, e, c, s)


@kernel
def settle_modes(surface, parcel, work, e):
    """Loads and sums of every mode; a captured mode must span a plane. Returns the status."""
    groups = parcel.ctl[at.N_GROUPS]
    for m in range(1 << groups):
        status = settle_mode(surface, parcel, work, m)
        if status != at.MOVING:
            return status
        gather(work, surface, parcel, m, e, at.COMPLETE)
        if groups > 0 and work.segs[m, at.RANK] < 2:
            return at.TIPPED
    return at.MOVING


@kernel
def settled(surface, parcel, work, e, c, s):
    """Find the loads at this instant, and the fractions of the modes where chatter is captured.

    Releases groups whose fractions leave [0, 1], and all of them where a mode does not stand. Returns the status; with
    TIPPED the edge is in ``ctl``.
    """
    mem, ctl = parcel.mem, parcel.ctl
    while ctl[at.N_GROUPS] > 0:
        status = settle_modes(surface, parcel, work, e)
        if status != at.MOVING:
            while ctl[at.N_GROUPS] > 0:
                release_inside(surface, mem, ctl, ctl[at.N_GROUPS] - 1)
                ctl[at.N_CAPTURES] += 1
            continue
        surfaces(surface, parcel, work.grp)
        _, _, _, conditioning = mix(work, surface, parcel, e, c, s)
        if conditioning < SINGULAR:
            release_inside(surface, mem, ctl, ctl[at.N_GROUPS] - 1)
            ctl[at.N_CAPTURES] += 1
            continue
        share, group, far = least_share(parcel, work)
        if share >= -FRACTION_ZERO:
            return status
        release(surface, mem, ctl, group, far)
        ctl[at.N_CAPTURES] += 1
    status = settle_mode(surface, parcel, work, at.ZERO)
    if status == at.MOVING:
        gather(work, surface, parcel, at.ZERO, e, at.UNDONE)
    return status
