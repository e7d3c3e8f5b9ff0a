"""Active-set Newton method for the contact problem of one island.

The natural map of the problem (Alart and Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991)) is piecewise linear: the
*mode* of each constraint (apart, pushing, sticking, sliding either way) selects a linear system. The method solves the
system of the present modes and reads the next modes from the solution, until they repeat. Where modes go in circles,
sweeps of projected Gauss-Seidel find others to start from. Impulses that the motion does not determine (a box between
more faces than hold it) are regularised: proximal steps pull them to the last iterate.
"""

from __future__ import annotations

from typing import Final

from plant.kernels.common import layout as at
from plant.kernels.common.jit import kernel
from plant.kernels.contact.problem import remaining_error

IDLE: Final = 0
ACTIVE: Final = 1
"""A normal that pushes; a tangent that slides has the sense of its friction, 1 or -1."""
STICKS: Final = 2
PROXIMAL: Final = 1e-9
"""Weight of the last iterate, over the constraint's own yielding."""
PROXIMAL_STEPS: Final = 4
REPEATED: Final = 1e-14
"""Change of impulses in a proximal step, over the largest, that is rounding."""
NEWTON_STEPS: Final = 25
STAGES: Final = 9
"""Attempts, each after more sweeps than the last."""
HELD_STAGES: Final = 3
COMBINATIONS: Final = 2_000
"""Combinations of modes to start from at last; islands of a few points have no more."""
MOST_SWEEPS: Final = 5_000
UNDAMPED: Final = 5
"""Attempts after which sweeps are damped, more each time: strong friction at several points can go in circles."""


@kernel
def update_modes(count, faces, impulse, work):
    """Read the modes from impulses and motions. Returns how many have changed."""
    changed = at.ZERO
    for f in range(faces):
        work.push[f] = 0.0
    for n in range(count):
        pushes = impulse[n] - work.motion[n] / work.matrix[n, n]
        mode = ACTIVE if pushes > 0.0 else IDLE
        changed += mode != work.mode[n]
        work.mode[n] = mode
        work.push[work.face[n]] += max(pushes, 0.0)
    for f in range(faces):
        t = count + f
        pulls, most = impulse[t] - work.motion[t] / work.matrix[t, t], work.friction[f] * work.push[f]
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
def select_unknowns(count, work):
    """List the constraints with unknown impulses, a face's together, which keeps chains banded. Returns how many."""
    size = at.ZERO
    for n in range(count):
        if work.mode[n] == ACTIVE:
            work.unknowns[size] = n
            size += 1
        if (n == count - 1 or work.face[n + 1] != work.face[n]) and work.mode[count + work.face[n]] == STICKS:
            work.unknowns[size] = count + work.face[n]
            size += 1
    return size


@kernel
def solve_linear(system, solution, size, last):
    """Solve a linear system in place: Gaussian elimination with partial pivoting; rows end at their last entry.

    Args:
        system: ``(., .)``, its first ``size`` rows and columns; destroyed.
        solution: right-hand side, then the solution.
        size: number of unknowns.
        last: ``(2, .)`` scratch.

    Returns:
        Whether the system is regular.
    """
    for r in range(size):
        k = size - 1
        while k > r and system[r, k] == 0.0:
            k -= 1
        last[0, r] = k
        k = size - 1
        while k > r and system[k, r] == 0.0:
            k -= 1
        last[1, r] = k
    deep = at.ZERO
    for c in range(size):
        deep = max(deep, last[1, c])
        p = c
        for r in range(c + 1, deep + 1):
            if abs(system[r, c]) > abs(system[p, c]):
                p = r
        if system[p, c] == 0.0:
            return False
        if p != c:
            for k in range(c, max(last[0, c], last[0, p]) + 1):
                system[c, k], system[p, k] = system[p, k], system[c, k]
            solution[c], solution[p] = solution[p], solution[c]
            last[0, c], last[0, p] = last[0, p], last[0, c]
        for r in range(c + 1, deep + 1):
            if system[r, c] != 0.0:
                factor = system[r, c] / system[c, c]
                for k in range(c + 1, last[0, c] + 1):
                    system[r, k] -= factor * system[c, k]
                last[0, r] = max(last[0, r], last[0, c])
                solution[r] -= factor * solution[c]
    for n in range(size):
        c = size - 1 - n
        total = solution[c]
        for k in range(c + 1, last[0, c] + 1):
            total -= system[c, k] * solution[k]
        solution[c] = total / system[c, c]
    return True


@kernel
def solve_modes(count, faces, impulse, work):
    """Solve the linear system of the present modes, from ``impulse`` on. Returns whether it is regular."""
    size = select_unknowns(count, work)
    for _ in range(PROXIMAL_STEPS):
        for a in range(size):
            c = work.unknowns[a]
            for b in range(size):
                d = work.unknowns[b]
                value = work.matrix[c, d]
                if d < count:
                    t = count + work.face[d]
                    if abs(work.mode[t]) == 1:
                        value += work.mode[t] * work.friction[work.face[d]] * work.matrix[c, t]
                work.system[a, b] = value
            weight = PROXIMAL * work.matrix[c, c]
            work.system[a, a] += weight
            work.solution[a] = weight * impulse[c] - work.lacking[c]
        if not solve_linear(work.system, work.solution, size, work.last):
            return False
        change = largest = 0.0
        for a in range(size):
            change = max(change, abs(work.solution[a] - impulse[work.unknowns[a]]))
            largest = max(largest, abs(work.solution[a]))
        for c in range(count + faces):
            impulse[c] = 0.0
        for a in range(size):
            impulse[work.unknowns[a]] = work.solution[a]
        for n in range(count):
            t = count + work.face[n]
            if abs(work.mode[t]) == 1:
                impulse[t] += work.mode[t] * work.friction[work.face[n]] * impulse[n]
        if change <= REPEATED * largest:
            break
    return True


@kernel
def sweep(count, faces, impulse, work, times, share):
    """Projected Gauss-Seidel, ``times`` times in order: each constraint goes ``share`` of the way it would alone."""
    remaining_error(count, faces, impulse, work)
    for _ in range(times):
        for n in range(count):
            f = work.face[n]
            change = share * (max(impulse[n] - work.motion[n] / work.matrix[n, n], 0.0) - impulse[n])
            work.push[f] += change
            change_impulse(count + faces, impulse, n, change, work)
            if (n == count - 1 or work.face[n + 1] != f) and (work.held[f] != 0 or work.friction[f] > 0.0):
                t = count + f
                pull = impulse[t] - work.motion[t] / work.matrix[t, t]
                if work.held[f] == 0:
                    most = work.friction[f] * work.push[f]
                    pull = min(max(pull, -most), most)
                change_impulse(count + faces, impulse, t, share * (pull - impulse[t]), work)


@kernel
def change_impulse(size, impulse, c, change, work):
    """Change an impulse, and with it the motion along all constraints."""
    if change != 0.0:
        impulse[c] += change
        for d in range(size):
            work.motion[d] += work.matrix[d, c] * change


@kernel
def improve(count, faces, impulse, enough, work):
    """Take Newton steps from ``impulse``; it ends at the best iterate. Returns its error."""
    best = remaining_error(count, faces, impulse, work)
    for c in range(count + faces):
        work.best[c] = impulse[c]
        work.mode[c] = IDLE
    for step in range(NEWTON_STEPS):
        if best <= enough or (update_modes(count, faces, impulse, work) == 0 and step > 0):
            break
        if not solve_modes(count, faces, impulse, work):
            break
        error = remaining_error(count, faces, impulse, work)
        if error < best:
            best = error
            for c in range(count + faces):
                work.best[c] = impulse[c]
    for c in range(count + faces):
        impulse[c] = work.best[c]
    return best


@kernel
def set_combination(count, faces, number, work):
    """Set the modes to one of all combinations, numbered from 0."""
    for n in range(count):
        work.mode[n] = number % 2
        number //= 2
    for f in range(faces):
        t = count + f
        if work.held[f] != 0:
            work.mode[t] = STICKS
        elif work.friction[f] == 0.0:
            work.mode[t] = IDLE
        else:
            sense = number % 3
            work.mode[t] = STICKS if sense == 0 else (1 if sense == 1 else -1)
            number //= 3


@kernel
def solve_island(count, faces, enough, accepted, work):
    """Find the impulses of an assembled island, ``work.impulse``.

    Args:
        count: number of normals.
        faces: number of faces.
        enough: error, as a motion, at which the search ends.
        accepted: error above which another attempt is made.
        work: workspace; ``arms`` to ``matrix`` are assembled.

    Returns:
        The error of the impulses, as a motion.
    """
    size, best, times, share = count + faces, 1e300, 2, 1.0
    stages, combinations = STAGES, COMBINATIONS
    for f in range(faces):
        if work.held[f] != 0:
            # faces that hold each other all round can ask for the impossible, which no search finds
            stages, combinations = HELD_STAGES, at.ZERO
    for c in range(size):
        work.start[c] = 0.0
    for stage in range(stages):
        sweep(count, faces, work.start, work, times, share)
        for c in range(size):
            work.trial[c] = work.start[c]
        error = improve(count, faces, work.trial, enough, work)
        if error < best:
            best = error
            for c in range(size):
                work.impulse[c] = work.trial[c]
        if best <= accepted:
            break
        times = min(6 * times, MOST_SWEEPS)
        if stage >= UNDAMPED:
            share *= 0.5
    for number in range(combinations):
        if best <= accepted:
            break
        set_combination(count, faces, number, work)
        for c in range(size):
            work.trial[c] = 0.0
        if solve_modes(count, faces, work.trial, work):
            error = improve(count, faces, work.trial, enough, work)
            if error < best:
                best = error
                for c in range(size):
                    work.impulse[c] = work.trial[c]
    return best
