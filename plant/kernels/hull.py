"""Whether a parcel stands: its centre of mass against the convex hull of its supports."""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel


@kernel
def outside_hull(pos, mem, ctl, y, pitch, mark):
    """How far the centre of mass lies outside the convex hull of one mode's cells, and by which edge.

    Returns (distance in m, negative inside; cell, cell) with the two supports of the edge it is farthest outside
    of. Gift wrapping: only called when a load would be negative or the supports don't span a plane. Cells lie on a
    lattice, so that any triangle of them has at least half a pitch squared: less is rounding, and a line.
    """
    straight = 0.5 * pitch * pitch
    count = ctl[at.N_MEMBERS]
    first = -1
    for i in range(count):
        if mem[i, mark] == at.ABSENT:
            continue
        if first < 0:
            first = i
        a, b = mem[i, at.CELL], mem[first, at.CELL]
        if pos[a, 0] < pos[b, 0] or (pos[a, 0] == pos[b, 0] and pos[a, 1] < pos[b, 1]):
            first = i
    worst, edge_a, edge_b = -1e300, mem[first, at.CELL], mem[first, at.CELL]
    corners, here = 0, first
    while corners <= count:
        ax, ay = pos[mem[here, at.CELL], 0] - y[0], pos[mem[here, at.CELL], 1] - y[1]
        following = -1
        fx, fy = 0.0, 0.0
        for i in range(count):
            dx, dy = pos[mem[i, at.CELL], 0] - y[0] - ax, pos[mem[i, at.CELL], 1] - y[1] - ay
            if (dx == 0.0 and dy == 0.0) or mem[i, mark] == at.ABSENT:
                continue
            cross = fx * dy - fy * dx
            farther = abs(cross) < straight and dx * dx + dy * dy > fx * fx + fy * fy
            if following < 0 or cross <= -straight or farther:
                following, fx, fy = i, dx, dy
        if following < 0:
            return (ax * ax + ay * ay) ** 0.5, edge_a, edge_b
        size = (fx * fx + fy * fy) ** 0.5
        distance = (ay * fx - ax * fy) / size  # outward is to the right of a counter-clockwise edge
        along = -(ax * fx + ay * fy) / size
        if corners == 1 and following == first:
            # all on one line: the hull is a segment, left over its side or past one of its ends
            past = max(-along, along - size)
            off = abs(distance)
            if past > off:
                end = mem[following if along > 0.0 else here, at.CELL]
                return (off * off + past * past) ** 0.5, end, end
            return (
                (off if past <= 0.0 else (off * off + past * past) ** 0.5),
                mem[here, at.CELL],
                mem[following, at.CELL],
            )
        if distance > worst:
            worst, edge_a, edge_b = distance, mem[here, at.CELL], mem[following, at.CELL]
        corners += 1
        here = following
        if here == first:
            break
    return worst, edge_a, edge_b
