"""Angular momentum of bodies whose places are corrected.

Two bodies are parted by equal and opposite impulses ``S`` over their masses, which shift their places and leave their
velocities. Angular momentum about any fixed point changes by ``S × V``, where ``V`` is the velocity of the second
centre of mass relative to the first. Equal and opposite impulses across the normal, at the centres of mass, take this
change out: two bodies that get farther apart along the normal pass each other more slowly.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to


@kernel
def keep_angular_momentum(count, share, pushed, states, inverse, work):
    """Change velocities so that shifts of places leave linear and angular momentum unchanged.

    Shifts along normals never add energy in this way. Two kinds of pair keep their velocities: pairs with a standing
    body, which takes any momentum, and pairs shifted along the normal by more than the centres of mass are apart.

    Args:
        count: number of rows in ``work`` that the shifts belong to.
        share: shift times mass per impulse, s for impulses and 1 for shifts.
        pushed: ``(3 k,)`` impulses of each pair, two along the normal and one across.
        states: ``(b, 6)`` after the shifts; velocities are changed.
        inverse: ``(b, 2)`` one over mass and over moment of inertia; 0, 0 for standing bodies.
        work: ``plant.effects.parcel_contact.bodies.ContactWorkspace``.
    """
    rows, ends, gained = work.rows, work.ends, work.third
    for i in range(states.shape[0]):
        for k in range(2):
            gained[i, k] = 0.0
    end = at.ZERO
    while end < count:
        begin, pair, along = end, ends[end, to.PAIR], at.NOTHING
        while end < count and ends[end, to.PAIR] == pair:
            along += share * pushed[3 * pair + end - begin]
            end += 1
        across = share * pushed[3 * pair + 2]
        i, j = ends[begin, 0], ends[begin, 1]
        nx, ny = rows[begin, to.NORMAL_X], rows[begin, to.NORMAL_Y]
        apart = nx * (states[j, 0] - states[i, 0]) + ny * (states[j, 1] - states[i, 1])
        stands = inverse[i, 0] == 0.0 or inverse[j, 0] == 0.0
        if not stands and apart > along * (inverse[i, 0] + inverse[j, 0]):
            # velocities before any impulse, places after all shifts: then the sum over pairs is exact
            vx, vy = states[j, 3] - states[i, 3], states[j, 4] - states[i, 4]
            impulse = (across * (nx * vx + ny * vy) - along * (nx * vy - ny * vx)) / apart
            gained[i, 0] += inverse[i, 0] * impulse * ny
            gained[i, 1] -= inverse[i, 0] * impulse * nx
            gained[j, 0] -= inverse[j, 0] * impulse * ny
            gained[j, 1] += inverse[j, 0] * impulse * nx
    for i in range(states.shape[0]):
        for k in range(2):
            states[i, 3 + k] += gained[i, k]
