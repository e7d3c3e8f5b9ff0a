"""Contact impulses of random islands: the conditions of the contact problem, checked by other means.

A velocity solves the problem if no point closes and the change of momentum is a sum of impulses that its points may
give at that velocity. The second condition is one of non-negative least squares.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import nnls

from plant.effects.parcel_contact import bodies
from plant.effects.parcel_contact.bodies import ContactWorkspace, Group, Shapes, make_workspace
from plant.kernels.contact import entry as contact_entry
from plant.kernels.contact import layout as to
from plant.kernels.contact import problem
from plant.kernels.contact.pivoting import pivot

Floats = NDArray[np.float64]
CASES = 1000
"""Random islands of each kind."""
SOLVES = 1e-8
"""Difference of velocities, m/s, and flaw of a solution of the exhaustive search."""
CLOSED = 1e-10
"""Motion, m/s, of a point that neither opens nor slides; velocities are about 1 m/s."""


class Island:
    """Bodies of 1 kg or so with random faces between them and to body 0, which stands."""

    def __init__(self, draw: np.random.Generator, bodies: int, faces: int) -> None:
        self.inverse: Floats = np.zeros((bodies + 1, 2))
        self.inverse[1:] = draw.uniform(0.3, 3.0, (bodies, 2)) * [1.0, 20.0]
        self.states: Floats = np.zeros((bodies + 1, 6))
        self.states[1:, :3] = draw.normal(0.0, 0.3, (bodies, 3))
        self.states[1:, 3:] = draw.normal(0.0, 1.0, (bodies, 3))
        self.pairs = np.array([self._pair(draw, bodies, k) for k in range(faces)], dtype=np.int64)
        self.group = Group(
            names=np.arange(bodies + 1),
            moving=np.arange(1, bodies + 1),
            pairs=self.pairs,
            shapes=Shapes(
                np.zeros(bodies + 2, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
            ),
            inverse=self.inverse,
            pull=np.zeros((bodies + 1, to.PULL_SIZE)),
            still=np.zeros((bodies + 1, 6)),
            slow=1e-3,
        )
        self.work: ContactWorkspace = make_workspace(self.group)
        self.count = 0
        for pair in range(faces):
            angle, width = draw.uniform(0.0, 2.0 * np.pi), draw.choice([0.0, 0.3])
            middle, along = draw.normal(0.0, 0.3, 2), np.array([-np.sin(angle), np.cos(angle)])
            for side in (-0.5, 0.5) if width else (0.0,):
                self._add(pair, middle + side * width * along, np.array([np.cos(angle), np.sin(angle)]))

    @staticmethod
    def _pair(draw: np.random.Generator, bodies: int, k: int) -> list[int]:
        # each body follows an earlier one, so that all are one island; further faces are anywhere
        if k < bodies:
            return [int(draw.integers(0, k + 1)), k + 1]
        first, second = sorted(draw.choice(bodies + 1, 2, replace=False).tolist())
        return [first, second]

    def _add(self, pair: int, point: Floats, normal: Floats) -> None:
        row, (i, j) = self.work.rows[self.count], self.pairs[pair]
        row[:] = 0.0
        row[[to.PX, to.PY]], row[[to.NORMAL_X, to.NORMAL_Y]] = point, normal
        row[[to.AX, to.AY]] = point - self.states[i, :2]
        row[[to.BX, to.BY]] = point - self.states[j, :2]
        self.work.ends[self.count] = i, j, pair
        self.count += 1

    def arms(self, n: int, *, across: bool) -> Floats:
        """Forces and moments ``(b, 3)`` of a unit impulse at a point, along its normal or across."""
        row, (i, j, _) = self.work.rows[n], self.work.ends[n]
        x, y = row[to.NORMAL_X], row[to.NORMAL_Y]
        x, y = (-y, x) if across else (x, y)
        out = np.zeros((len(self.inverse), 3))
        out[i] -= [x, y, row[to.AX] * y - row[to.AY] * x]
        out[j] += [x, y, row[to.BX] * y - row[to.BY] * x]
        return out

    def struck(self, friction: float) -> Floats:
        """Velocities ``(b, 3)`` after an impact without restitution."""
        after = self.states.copy()
        contact_entry.collide(self.group, self.count, after, 0.0, friction, False, self.work)
        return after[:, 3:]

    def given(self) -> Floats:
        """Impulses ``(b, 3)``, force and moment, that the last impact gave each body, the standing one included."""
        out, seen = np.zeros((len(self.inverse), 3)), np.zeros(len(self.pairs), dtype=np.int64)
        points = np.bincount(self.work.ends[: self.count, to.PAIR], minlength=len(self.pairs))
        for n in range(self.count):
            pair = int(self.work.ends[n, to.PAIR])
            out += self.work.shifted[3 * pair + seen[pair]] * self.arms(n, across=False)
            out += self.work.shifted[3 * pair + 2] / points[pair] * self.arms(n, across=True)
            seen[pair] += 1
        return out

    def flaw(self, after: Floats, friction: float) -> float:
        """How far velocities are from a solution: the fastest closing, or the momentum that no impulse explains."""
        generators: list[Floats] = []
        worst = 0.0
        for n in range(self.count):
            normal, across = self.arms(n, across=False), self.arms(n, across=True)
            opening, sliding = float(np.sum(normal * after)), float(np.sum(across * after))
            worst = max(worst, -opening)
            if opening > CLOSED:
                continue
            senses = (1.0, -1.0) if abs(sliding) <= CLOSED else (-np.sign(sliding),)
            generators += [normal + friction * sense * across for sense in senses]
        moving = self.inverse[:, 0] > 0.0
        change = (after - self.states[:, 3:])[moving] / self.inverse[moving][:, [0, 0, 1]]
        if not generators:
            return max(worst, float(np.abs(change).max()))
        matrix = np.array([one[moving].ravel() for one in generators]).T
        return max(worst, float(nnls(matrix, change.ravel(), maxiter=1000)[1]))


def islands(seed: int, most: int) -> Iterator[Island]:
    """Random islands of at most so many points."""
    draw = np.random.default_rng(seed)
    while True:
        bodies = int(draw.integers(1, 5))
        island = Island(draw, bodies, bodies + int(draw.integers(0, 3)))
        if island.count <= most:
            yield island


@pytest.mark.parametrize(
    "friction", [0.0, 0.5, *(pytest.param(friction, marks=pytest.mark.slow) for friction in (0.1, 1.0))]
)
def test_velocities_after_an_impact_are_a_solution(friction: float) -> None:
    flaws = np.zeros(CASES)
    for case, island in zip(range(CASES), islands(7, 8), strict=False):
        flaws[case] = island.flaw(island.struck(friction), friction)
    assert flaws.max() < 1e-9


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_impulses_account_for_momentum_and_energy_with_the_standing_bodys_share(friction: float) -> None:
    flaws = np.zeros(CASES)
    for case, island in zip(range(CASES), islands(7, 8), strict=False):
        after, before, given = island.struck(friction), island.states[:, 3:], island.given()
        mass = 1.0 / island.inverse[1:][:, [0, 0, 1]]
        places = np.vstack([np.zeros(2), island.states[1:, :2]])
        # moments about the origin, where the standing body is
        about = given[:, 2] + places[:, 0] * given[:, 1] - places[:, 1] * given[:, 0]
        gained = mass * (after - before)[1:]
        work = np.sum(given[1:] * 0.5 * (after + before)[1:])
        energy = 0.5 * np.sum(mass * (after[1:] ** 2 - before[1:] ** 2))
        off = (gained - given[1:], given[:, :2].sum(axis=0), about.sum(), energy - work)
        flaws[case] = max(float(np.abs(one).max()) for one in off)
    assert flaws.max() < 1e-9


def test_the_check_bites() -> None:
    island = next(islands(7, 8))
    after = island.struck(0.3)
    after[1, 0] += 1e-6
    assert island.flaw(after, 0.3) > 1e-8


def modes(island: Island, friction: float) -> Iterator[tuple[list[int], list[int]]]:
    """All combinations of modes: whether each point pushes, and 0 for a face that sticks or the sense it slides in."""
    faces = len(island.pairs)
    for pushing in product((0, 1), repeat=island.count):
        pushed = {int(island.work.ends[n, to.PAIR]) for n in range(island.count) if pushing[n]}
        senses = [(0, 1, -1) if f in pushed and friction > 0.0 else (0,) for f in range(faces)]
        for sliding in product(*senses):
            yield list(pushing), list(sliding)


def exhaustive(island: Island, friction: float) -> list[Floats]:
    """Velocities ``(b, 3)`` of every combination of modes in which some impulses solve the problem.

    The least impulses are tried, and where others have the same motion those that push, and hold within friction.
    """
    moving = island.inverse[:, 0] > 0.0
    weight = np.repeat(island.inverse[moving], [2, 1], axis=1).ravel()
    start = island.states[moving, 3:].ravel()
    normal = np.array([island.arms(n, across=False)[moving].ravel() for n in range(island.count)])
    across = np.array([island.arms(n, across=True)[moving].ravel() for n in range(island.count)])
    pair = island.work.ends[: island.count, to.PAIR]
    tangent = np.array([across[pair == f].mean(axis=0) for f in range(len(island.pairs))])
    found: list[Floats] = []
    for pushing, sliding in modes(island, friction):
        on = [n for n in range(island.count) if pushing[n]]
        stuck = [f for f in sorted({int(pair[n]) for n in on}) if sliding[f] == 0 and friction > 0.0]
        active = [*(normal[n] for n in on), *(tangent[f] for f in stuck)]
        applied = [*(normal[n] + sliding[int(pair[n])] * friction * tangent[pair[n]] for n in on)]
        applied += [tangent[f] for f in stuck]
        tried = [start]
        if active:
            rows, columns = np.array(active), np.array(applied)
            matrix = rows @ (weight[:, None] * columns.T)
            impulse, _, rank, _ = np.linalg.lstsq(matrix, -rows @ start)
            tried = [start + weight * (columns.T @ impulse)]
            if rank < len(active):
                # friction of a face that sticks is between its two extremes
                ends = [
                    sense for n in on for sense in ((1, -1) if pair[n] in stuck else (sliding[int(pair[n])],))
                ]
                points = [n for n in on for _ in range(2 if pair[n] in stuck else 1)]
                extremes = normal[points] + friction * np.array(ends)[:, None] * tangent[pair[points]]
                pushes = nnls(rows @ (weight[:, None] * extremes.T), -rows @ start, maxiter=1000)[0]
                tried.append(start + weight * (extremes.T @ pushes))
        for after in tried:
            full = np.zeros_like(island.states[:, 3:])
            full[moving] = after.reshape(-1, 3)
            if island.flaw(full, friction) < SOLVES:
                found.append(full)
    return found


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize(
    ("seed", "cases"),
    [
        (11, 30),
        pytest.param(0, CASES // 5, marks=pytest.mark.slow),
        *(
            pytest.param(seed, CASES // 5, marks=[pytest.mark.slow, pytest.mark.nightly])
            for seed in range(1, 5)
        ),
    ],
)
def test_velocities_are_among_those_of_an_exhaustive_search(seed: int, cases: int, friction: float) -> None:
    far = np.zeros(cases)
    for case, island in zip(range(cases), islands(seed, 6 if friction else 8), strict=False):
        found = exhaustive(island, friction)
        after = island.struck(friction)
        far[case] = min((float(np.abs(after - one).max()) for one in found), default=np.inf)
    assert far.max() < SOLVES


@njit(error_model="numpy")
def _by_pivoting(rows, ends, work, inverse, motion):  # type: ignore[no-untyped-def]
    """Impulses of all islands by Lemke's method alone. Returns whether it always ended, and the largest error."""
    island, begin, ended, worst = work.impulses, 0, True, 0.0
    for k in range(problem.sort_islands(ends, len(ends), inverse, island)):
        end = island.until[island.island[k]]
        faces = problem.number_faces(ends, begin, end, island)
        scale = problem.assemble(rows, ends, island.row[begin:end], faces, inverse, motion, island)
        ended &= pivot(end - begin, faces, island.impulse, island.table, 1e-10, inverse, island)
        error = problem.remaining_error(end - begin, faces, island.impulse, inverse, island)
        worst = max(worst, error / scale)
        problem.apply_impulses(end - begin, faces, island.impulse, inverse, motion, island)
        begin = end
    return ended, worst


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_lemkes_method_solves_by_itself(friction: float) -> None:
    for case, island in zip(range(300), islands(13, 8), strict=False):
        island.work.rows[: island.count, to.FRICTION] = friction
        after = island.states[:, 3:].copy()
        rows, ends = island.work.rows[: island.count], island.work.ends[: island.count]
        ended, error = _by_pivoting(rows, ends, island.work, island.inverse, after)
        assert ended, case
        assert error < 1e-9, case
        if error < 1e-12:  # the other check takes what slides at 1e-10 m/s for sliding
            assert island.flaw(after, friction) < 1e-9, case


def test_a_problem_that_no_method_solves_is_solved_without_friction_and_its_error_noted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # without room for linear systems and tables sweeps are left, which strong friction leads in circles
    monkeypatch.setattr(bodies, "BANDED", 0)
    monkeypatch.setattr(bodies, "PIVOTED", 0)
    slippery = 0
    for _, island in zip(range(1000), islands(13, 8), strict=False):
        after = island.struck(1.0)
        if island.work.impulses.tally[to.SLIPPERY] == 0:
            continue
        slippery += 1
        opening = min(float(np.sum(island.arms(n, across=False) * after)) for n in range(island.count))
        # what still closes is told
        assert -opening <= max(1.001 * float(island.work.left[to.ERROR]), 1e-6)
    assert slippery > 5
