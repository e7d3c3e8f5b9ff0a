"""Chatter at a surface that attracts from both sides, replaced by motion along it (Filippov).

A parcel that settles at an orientation where the support set changes crosses the same surface ever faster. Once the
amplitude of that motion falls below ``capture_m``, the cells on the surface are captured: they carry the fraction of
their load that keeps the surface's second rate at zero, and the parcel moves along the surface. Cells whose
surfaces coincide are captured as one group.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.loads import plane, release


@kernel
def edge_of(pos, normal, offset, cell, y, c, s):
    """The edge on whose line a cell lies nearest."""
    px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
    qx, qy = c * px + s * py, -s * px + c * py
    nearest, least = 0, 1e300
    for edge in range(offset.shape[0]):
        distance = abs(offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy)
        if distance < least:
            nearest, least = edge, distance
    return nearest


@kernel
def edge_motion(pos, normal, cell, edge, y, c, s, ax, ay, al):
    """Rate and second rate of a cell's distance inside an edge, for the accelerations given."""
    nx = c * normal[edge, 0] - s * normal[edge, 1]
    ny = s * normal[edge, 0] + c * normal[edge, 1]
    rx, ry = y[0] - pos[cell, 0], y[1] - pos[cell, 1]
    om = y[at.OMEGA]
    along, across = nx * rx + ny * ry, -ny * rx + nx * ry
    rate = nx * y[at.UX] + ny * y[at.UY] + om * across
    second = nx * ax + ny * ay + al * across - om * om * along
    second += 2.0 * om * (-ny * y[at.UX] + nx * y[at.UY])
    return rate, second, across, nx, ny


@kernel
def attracts(rate, off, on, capture):
    """True where the surface draws the parcel in from both sides and the motion about it is below ``capture``."""
    if not (off > 0.0 > on):
        return False
    return rate * rate < 2.0 * capture * min(off, -on)


@kernel
def coincide(pos, normal, cells, edges, count, y, c, s, capture):
    """True where the cells' surfaces turn alike about the centre of mass and have parallel or opposite normals.

    Opposite normals are the pair of a symmetric scene: their distances are equal while the centre of mass lies
    midway, and only then do they reach their edges together.
    """
    _, _, across0, nx0, ny0 = edge_motion(pos, normal, cells[0], edges[0], y, c, s, 0.0, 0.0, 0.0)
    for i in range(1, count):
        _, _, across, nx, ny = edge_motion(pos, normal, cells[i], edges[i], y, c, s, 0.0, 0.0, 0.0)
        if abs(across - across0) > capture or abs(nx * ny0 - ny * nx0) > 1e-9:
            return False
    return True


@kernel
def form_group(mem, share, ctl, cells, edges, loads, count):
    """Capture the cells as a new group, each with a share in proportion to the load it would carry."""
    total = 0.0
    for i in range(count):
        total += max(loads[i], 0.0)
    group = ctl[at.N_GROUPS]
    for i in range(count):
        slot = -1
        for j in range(ctl[at.N_MEMBERS]):
            if mem[j, at.CELL] == cells[i]:
                slot = j
        if slot < 0:
            slot = ctl[at.N_MEMBERS]
            ctl[at.N_MEMBERS] += 1
            mem[slot, at.CELL] = cells[i]
        mem[slot, at.MARK] = at.CAPTURED
        mem[slot, at.EDGE] = edges[i]
        mem[slot, at.GROUP] = group
        share[slot] = max(loads[i], 0.0) / total if total > 0.0 else 1.0 / count
    ctl[at.N_GROUPS] = group + 1


@kernel
def may_capture(seg, ctl, crossed, direction, cells, edges, pos, normal, y, c, s, capture, before, after):
    """Whether the cells that just crossed sit on one surface that attracts from both sides."""
    if crossed == 0 or direction == 0 or ctl[at.N_GROUPS] >= at.MAX_GROUPS or seg[at.RANK] < 2:
        return False
    if not coincide(pos, normal, cells, edges, crossed, y, c, s, capture):
        return False
    rate, second_before, _, _, _ = edge_motion(
        pos, normal, cells[0], edges[0], y, c, s, before[0], before[1], before[2]
    )
    _, second_after, _, _, _ = edge_motion(
        pos, normal, cells[0], edges[0], y, c, s, after[0], after[1], after[2]
    )
    if direction > 0:
        return attracts(rate, second_before, second_after, capture)
    return attracts(rate, second_after, second_before, capture)


@kernel
def groups_hold(pos, mem, share, ctl, y, normal, offset, c, s, capture):
    """Release groups whose cells no longer lie on their common surface (a pair that drifts apart)."""
    h = 0
    while h < ctl[at.N_GROUPS]:
        low, high = 1e300, -1e300
        for i in range(ctl[at.N_MEMBERS]):
            if mem[i, at.MARK] == at.CAPTURED and mem[i, at.GROUP] == h:
                px, py = pos[mem[i, at.CELL], 0] - y[0], pos[mem[i, at.CELL], 1] - y[1]
                qx, qy = c * px + s * py, -s * px + c * py
                edge = mem[i, at.EDGE]
                distance = offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy
                low, high = min(low, distance), max(high, distance)
        if high - low > 2.0 * capture:
            release(mem, share, ctl, h, True)
            ctl[at.N_CAPTURES] += 1
        else:
            h += 1


@kernel
def capture_crossed(pos, mem, share, ctl, y, seg, grp, f, cells, edges, loads, crossed):
    """Capture the cells that just crossed as one group, their shares in proportion to their full loads."""
    a0, bx, by = plane(seg, grp, f, ctl[at.N_GROUPS])
    for i in range(crossed):
        rx, ry = pos[cells[i], 0] - y[0] - seg[at.CX], pos[cells[i], 1] - y[1] - seg[at.CY]
        loads[i] = a0 + bx * rx + by * ry
    form_group(mem, share, ctl, cells, edges, loads, crossed)
    ctl[at.N_CAPTURES] += 1
