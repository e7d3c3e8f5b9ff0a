"""Active-set Newton method for the contact problem of one island.

The natural map of the problem (Alart and Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991)) is piecewise linear: the
*mode* of each constraint (apart, pushing, sticking, sliding either way) selects a linear system. The method solves the
system of the present modes and reads the next modes from the solution, until they repeat. Impulses that the motion does
not determine (a box between more faces than hold it) are regularised: proximal steps pull them to the last iterate.
"""

from __future__ import annotations

from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact.linear import add_entries, factorise, select_unknowns, substitute
from plant.kernels.contact.problem import (
    COMPLIANCE,
    apply_impulses,
    motion_along,
    push_bodies,
    remaining_error,
)

IDLE: Final = 0
ACTIVE: Final = 1
"""A normal that pushes; a tangent that slides has the sense of its friction, 1 or -1."""
STICKS: Final = 2
PROXIMAL: Final = 1e-3
"""Weight of the last iterate, over the constraint's own yielding."""
HEAVIER: Final = 10.0
HEAVIEST: Final = 1.0
"""Factor on the weight where modes go in circles, and the largest weight."""
SLOW: Final = 0.1
LIGHTER: Final = 0.03
LIGHTEST: Final = 1e-9
"""Factor on the weight where a step leaves more than this share of the error, as in long rows, and the least weight."""
PROXIMAL_STEPS: Final = 40
NEWTON_STEPS: Final = 12
"""In a proximal step; more are going in circles."""
PATIENCE: Final = 4
"""Proximal steps that don't halve the error after which it is rounding."""


@kernel
def update_modes(count, faces, impulse, weight, work):
    """Read the modes from impulses and motions, those of the proximal step. Returns how many have changed."""
    changed = at.ZERO
    for f in range(faces):
        work.push[f] = 0.0
    for n in range(count):
        pushes = impulse[n] - work.motion[n] / work.yielding[n] - weight * (impulse[n] - work.anchor[n])
        mode = ACTIVE if pushes > 0.0 else IDLE
        changed += mode != work.mode[n]
        work.mode[n] = mode
        work.push[work.face[n]] += max(pushes, 0.0)
    for f in range(faces):
        t, most = count + f, work.friction[f] * work.push[f]
        pulls = impulse[t] - work.motion[t] / work.yielding[t] - weight * (impulse[t] - work.anchor[t])
        if work.held[f] != 0:
            mode = STICKS
        elif most == 0.0:
            mode = IDLE
        elif abs(pulls) <= most:
            mode = STICKS
        else:
            mode = 1 if pulls > 0.0 else -1
        changed += mode != work.mode[t]
        work.mode[t] = mode
    return changed


@kernel
def factorise_modes(count, faces, weight, inverse, work):
    """Factorise the system of the present modes. Returns (number of unknowns; half bandwidth, -1 if it can't)."""
    for c in range(count + faces):
        work.selected[c] = work.mode[c] == (ACTIVE if c < count else STICKS)
    size, half = select_unknowns(count, faces, work.selected, inverse, work)
    width = 3 * half + 1
    if size * width > work.system.shape[0]:
        return size, at.NO_CELL
    for f in range(faces):
        mode = work.mode[count + f]
        work.slope[f] = mode * work.friction[f] if abs(mode) == 1 else 0.0
    for k in range(size * width):
        work.system[k] = 0.0
    for a in range(size):
        add_entries(count, a, width, half, work.slope, inverse, work)
        c = work.unknowns[a]
        gives = weight if c < count or work.held[c - count] == 0 else weight + COMPLIANCE
        work.system[a * width + half] += gives * work.yielding[c]
    return size, half if factorise(size, half, work) else at.NO_CELL


@kernel
def solve_modes(count, faces, impulse, weight, size, half, work):
    """Write the impulses of the factorised modes, pulled towards ``work.anchor``."""
    for a in range(size):
        c = work.unknowns[a]
        work.solution[a] = weight * work.yielding[c] * work.anchor[c] - work.lacking[c]
    substitute(size, half, work)
    for c in range(count + faces):
        impulse[c] = 0.0
    for a in range(size):
        impulse[work.unknowns[a]] = work.solution[a]
    for n in range(count):
        impulse[count + work.face[n]] += work.slope[work.face[n]] * impulse[n]


@kernel
def improve(count, faces, impulse, enough, lightest, inverse, work):
    """Take proximal steps from ``impulse``, of a weight down to ``lightest``; it ends at the best iterate.

    Returns the best error.

    Each step solves the problem with ``weight`` times the yielding and the distance from the last iterate added to the
    motion, which has one solution however many the problem has, by Newton steps (Rockafellar, SIAM J. Control Optim. 14
    (1976)). While modes stay, so do the factors of their system.
    """
    size, best = count + faces, remaining_error(count, faces, impulse, inverse, work)
    unknowns, half, futile, weight = at.ZERO, at.NO_CELL, at.ZERO, PROXIMAL
    for c in range(size):
        work.best[c] = impulse[c]
        work.mode[c] = at.NO_CELL - 1
    for _ in range(PROXIMAL_STEPS):
        if best <= enough or futile == PATIENCE:
            break
        for c in range(size):
            work.anchor[c] = impulse[c]
        before, steps = best, at.ZERO
        while steps < NEWTON_STEPS:
            changed = update_modes(count, faces, impulse, weight, work)
            if changed == 0 and steps > 0:
                break
            if changed > 0:
                unknowns, half = factorise_modes(count, faces, weight, inverse, work)
            if half < 0:
                break
            steps += 1
            solve_modes(count, faces, impulse, weight, unknowns, half, work)
            error = remaining_error(count, faces, impulse, inverse, work)
            if error < best:
                best = error
                for c in range(size):
                    work.best[c] = impulse[c]
        if half < 0 or (steps == NEWTON_STEPS and weight >= HEAVIEST):
            break
        futile = 0 if best < 0.5 * before else futile + 1
        if steps == NEWTON_STEPS:
            weight *= HEAVIER
            for c in range(size):
                impulse[c] = work.best[c]
                work.mode[c] = at.NO_CELL - 1
            remaining_error(count, faces, impulse, inverse, work)
        elif best > SLOW * before and weight > lightest:
            weight = max(LIGHTER * weight, lightest)
            for c in range(size):
                work.mode[c] = at.NO_CELL - 1
    for c in range(size):
        impulse[c] = work.best[c]
    return best


@kernel
def sweep(count, faces, impulse, times, share, inverse, work):
    """Projected Gauss-Seidel, ``times`` times in order: each constraint goes ``share`` of the way it would alone."""
    for f in range(faces):
        for p in range(2):
            for k in range(3):
                work.gained[work.bodies[f, p], k] = 0.0
        work.push[f] = 0.0
    apply_impulses(count, faces, impulse, inverse, work.gained, work)
    for n in range(count):
        work.push[work.face[n]] += impulse[n]
    for _ in range(times):
        for f in range(faces):
            for n in range(work.normal[f], work.normal[f + 1]):
                wanted = impulse[n] - motion_along(count, n, work) / work.yielding[n]
                change = share * (max(wanted, 0.0) - impulse[n])
                work.push[f] += change
                impulse[n] += change
                push_bodies(count, n, change, inverse, work.gained, work)
            if work.held[f] != 0 or work.friction[f] > 0.0:
                t = count + f
                gives = COMPLIANCE * impulse[t] if work.held[f] != 0 else 0.0
                wanted = impulse[t] - motion_along(count, t, work) / work.yielding[t] - gives
                if work.held[f] == 0:
                    most = work.friction[f] * work.push[f]
                    wanted = min(max(wanted, -most), most)
                change = share * (wanted - impulse[t])
                impulse[t] += change
                push_bodies(count, t, change, inverse, work.gained, work)
