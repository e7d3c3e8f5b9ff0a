"""The support sets whose motions mix while chatter is captured, and what ends a capture.

A captured group of cells sits on a surface; on one side of it they are under the parcel, on the other they are not
(or the other way round for a cell that leaves as others enter). Each side is a support set of its own, with the loads
that it would have, lifted cells and all. Motion along the surface is the mixture of the two motions whose weight keeps
the parcel on it (Filippov). With more groups, one mode more for each.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.loads import settle
from plant.kernels.motion import accelerations, plane, surfaces

WEIGHT_ZERO = 1e-9
"""How far a weight may lie outside [0, 1] before its group is released."""
SINGULAR = 1e-9
"""Groups whose modes can't be told apart better than this are one too many."""


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
        if (m == group + 1) != (side > 0):
            mem[i, at.MARK + m] = at.ABSENT
        elif mem[i, at.MARK + m] == at.ABSENT:
            mem[i, at.MARK + m] = at.ACTIVE


@kernel
def release(mem, ctl, group, far):
    """End a captured group: its cells are from now on what they were on the far, or the near, side."""
    count = ctl[at.N_MEMBERS]
    for i in range(count):
        if far:
            mem[i, at.MARK] = mem[i, at.MARK + group + 1]
        for m in range(group + 1, at.MODES - 1):
            mem[i, at.MARK + m] = mem[i, at.MARK + m + 1]
    i = at.ZERO
    while i < ctl[at.N_MEMBERS]:
        side = mem[i, at.SIDE]
        if side != 0 and mem[i, at.GROUP] == group:
            if (side > 0) != far:
                drop(mem, ctl, i)
                continue
            mem[i, at.SIDE] = 0
            for m in range(at.MODES):
                if mem[i, at.MARK + m] == at.ABSENT:
                    mem[i, at.MARK + m] = at.ACTIVE
        elif side != 0 and mem[i, at.GROUP] > group:
            mem[i, at.GROUP] -= 1
        i += 1
    ctl[at.N_GROUPS] -= 1


@kernel
def release_inside(mem, ctl, group):
    """End a captured group on the side on which more of its cells are under the parcel."""
    balance = at.ZERO
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.SIDE] != 0 and mem[i, at.GROUP] == group:
            balance += mem[i, at.SIDE]
    release(mem, ctl, group, balance >= 0)


@kernel
def near_load(surface, parcel, segs, group, m):
    """Load share that the springs' plane of mode m has at a group's cells, over the mean load of mode 0."""
    a0, bx, by = plane(segs[m])
    total = 0.0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, at.SIDE] != 0 and parcel.mem[i, at.GROUP] == group:
            cell = parcel.mem[i, at.CELL]
            rx = surface.pos[cell, 0] - parcel.y[0] - segs[m, at.CX]
            ry = surface.pos[cell, 1] - parcel.y[1] - segs[m, at.CY]
            total += a0 + bx * rx + by * ry
    return total * segs[0, at.N_ACTIVE]


@kernel
def near_share(surface, parcel, work, group):
    """How much of the motion is on a group's near side: below nothing, it should be released on its far side.

    With one group that is the weight of mode 0. With more, sides other than those of the modes take part, and the
    share is measured by the load that is missing at the group's cells for them to carry all of theirs.
    """
    groups, weight = parcel.ctl[at.N_GROUPS], work.weight
    first = 1.0
    for h in range(groups):
        first -= weight[h]
    if groups == 1:
        return first
    total = first * near_load(surface, parcel, work.segs, group, at.ZERO)
    for h in range(groups):
        if h != group:
            total += weight[h] * near_load(surface, parcel, work.segs, group, h + 1)
    return total


@kernel
def least_share(surface, parcel, work):
    """The smallest share of either side over all groups. Returns (share, group, far: release it on the far side)."""
    worst, which, far = 1e300, -1, at.UNDONE
    for h in range(parcel.ctl[at.N_GROUPS]):
        if work.weight[h] < worst:
            worst, which, far = work.weight[h], h, at.UNDONE
        near = near_share(surface, parcel, work, h)
        if near < worst:
            worst, which, far = near, h, at.COMPLETE
    return worst, which, far


@kernel
def settle_modes(surface, parcel, work):
    """Loads of every mode; a captured mode must span a plane. Returns the status."""
    groups = parcel.ctl[at.N_GROUPS]
    for m in range(groups + 1):
        status = settle(surface, parcel, work, m)
        if status != at.MOVING:
            return status
        if groups > 0 and work.segs[m, at.RANK] < 2:
            return at.TIPPED
    return at.MOVING


@kernel
def settled(surface, parcel, work, e, c, s):
    """Find the loads at this instant, and the weights of the modes where chatter is captured.

    Releases groups whose weights leave [0, 1], and all of them where a mode does not stand. Returns the status; with
    TIPPED the edge is in ``ctl``.
    """
    mem, ctl = parcel.mem, parcel.ctl
    while True:
        status = settle_modes(surface, parcel, work)
        if ctl[at.N_GROUPS] == 0:
            return status
        if status != at.MOVING:
            while ctl[at.N_GROUPS] > 0:
                release_inside(mem, ctl, ctl[at.N_GROUPS] - 1)
                ctl[at.N_CAPTURES] += 1
            continue
        surfaces(surface, parcel, work.grp)
        _, _, _, conditioning = accelerations(parcel, work, e, c, s)
        if conditioning < SINGULAR:
            release_inside(mem, ctl, ctl[at.N_GROUPS] - 1)
            ctl[at.N_CAPTURES] += 1
            continue
        share, group, far = least_share(surface, parcel, work)
        if share >= -WEIGHT_ZERO:
            return status
        release(mem, ctl, group, far)
        ctl[at.N_CAPTURES] += 1
