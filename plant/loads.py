"""Support sets and loads of a parcel (eqs. 3-13, unilateral) in NumPy, for occasional queries.

The solvers with compiled kernels have the same in ``plant.kernels.common.loads``. Offsets are from the parcel's
centre of mass
and loads are shares of the weight throughout.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

NO_LOAD = 5e-13
"""A load, over the mean one, that counts as none, of either sign."""
ON_LINE = 1e-8
"""How far, over the pitch, a centre of mass may be off a line of supports, or outside all, and stand."""


class Supports(NamedTuple):
    """A support set, its loads affine in the centre of mass.

    Attributes:
        carrying: ``(n,)`` which of the cells under the parcel carry load.
        centroid_m: ``(2,)`` of those that do.
        plane: ``(n, 3)`` times ``[1, X - centroid]``: where the springs' plane is above each cell; where it carries,
            that is its load.
        across: ``(2,)`` unit normal of the line that the supports lie on; zero where they span a plane.
        rank: 2, or 1 where they lie on a line, 0 on a point.
    """

    carrying: Bools
    centroid_m: Floats
    plane: Floats
    across: Floats
    rank: int

    def off_m(self, place_m: Floats) -> float:
        """How far a centre of mass ``(2,)`` is off the line or point that is all there is to stand on."""
        away = place_m - self.centroid_m
        if self.rank == 2:
            return 0.0
        return abs(float(self.across @ away)) if self.rank == 1 else float(np.hypot(away[0], away[1]))


def share_matrix(offsets_m: Floats, others_m: Floats | None = None) -> Floats:
    """Load shares ``P [1; X - c]`` of cells that all carry, about their centroid c (eqs. 11-13).

    Args:
        offsets_m: ``(n, 2)`` cells, from their centroid.
        others_m: ``(m, 2)`` places at which the plane of those loads is computed instead.

    Returns:
        ``(n, 3)`` or ``(m, 3)``: mean share, and the (pseudo-)inverse of their second moments.
    """
    places = offsets_m if others_m is None else others_m
    p: Floats = np.full((len(places), 3), 1.0 / len(offsets_m))
    # what rounding leaves across a slanting line of supports is nothing
    p[:, 1:] = places @ np.linalg.pinv(offsets_m.T @ offsets_m, rcond=1e-12, hermitian=True)
    return p


def supports_of(offsets_m: Floats, carrying: Bools, pitch_m: float) -> Supports:
    """The support set in which just these cells carry, positions from wherever ``offsets_m`` ``(n, 2)`` are."""
    centroid = offsets_m[carrying].mean(axis=0)
    from_centroid = offsets_m - centroid
    _, size, axes = np.linalg.svd(from_centroid[carrying], full_matrices=True)
    rank = int(np.count_nonzero(size > 1e-6 * pitch_m))
    across: Floats = axes[1] if rank == 1 else np.zeros(2)
    return Supports(carrying, centroid, share_matrix(from_centroid[carrying], from_centroid), across, rank)


def find_supports(offsets_m: Floats, guess: Bools, pitch_m: float) -> Supports | None:
    """The cells under a parcel that carry it: least squares of the loads, none of which pulls.

    From a guess, the cell whose load is farthest from what it should be is turned round, one at a time.

    Args:
        offsets_m: ``(n, 2)`` cells under the parcel, from its centre of mass.
        guess: ``(n,)`` those that carried it last.
        pitch_m: of the array.

    Returns:
        None where no loads balance: the parcel tips.
    """
    if len(guess) == 0:
        return None
    carrying, restarted = guess.copy() if guess.any() else np.ones(len(guess), dtype=np.bool_), False
    for _ in range(10 * len(guess) + 10):
        found = supports_of(offsets_m, carrying, pitch_m)
        load = found.plane @ np.array([1.0, *-found.centroid_m])
        wrong = np.where(carrying, -load, load)
        if found.rank < 2:
            # a plane on a line of supports may tilt about it: cells beside it stay clear
            beside = (
                np.abs((offsets_m - found.centroid_m) @ found.across)
                if found.rank
                else np.full(len(load), np.inf)
            )
            wrong[(beside > ON_LINE * pitch_m) & ~carrying] = 0.0
        worst = int(np.argmax(wrong))
        if found.off_m(np.zeros(2)) <= ON_LINE * pitch_m:
            if wrong[worst] <= NO_LOAD / len(load):
                return found
            carrying[worst] = not carrying[worst]
            if carrying.any():
                continue
        if restarted or farthest_edge(offsets_m, pitch_m)[0] > 0.5 * ON_LINE * pitch_m:
            return None
        carrying, restarted = _least_norm(offsets_m / pitch_m), True
    return None


def _least_norm(offsets: Floats) -> Bools:
    """Which loads of the least norm that balance and don't pull are not zero.

    Least distance programming (Lawson and Hanson, Solving Least Squares Problems, chapter 23), the balances as pairs of
    inequalities.
    """
    # only for a parcel about to tip, or on few supports
    nnls: Any = import_module("scipy.optimize").nnls
    n = len(offsets)
    rows = np.vstack([np.ones(n), offsets.T])
    inequalities = np.vstack([rows, -rows, np.eye(n)])
    bounds = np.concatenate([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], np.zeros(n)])
    system = np.vstack([inequalities.T, bounds])
    target = np.append(np.zeros(n), 1.0)
    multipliers, _ = nnls(system, target, maxiter=50 * n + 100)
    residual = system @ multipliers - target
    load: Floats = -residual[:-1] / residual[-1]
    return load > 1e-9 / n


def farthest_edge(offsets_m: Floats, pitch_m: float) -> tuple[float, int, int]:
    """How far the centre of mass lies outside the convex hull of cells, and by which edge.

    Args:
        offsets_m: ``(n, 2)`` cells, from the centre of mass; n > 0.
        pitch_m: of the lattice they lie on: a triangle of less than half its square is a line.

    Returns:
        Distance in m, negative inside; the two cells of the edge it is farthest outside of, the same twice for a point.
    """
    n = len(offsets_m)
    along = offsets_m[None, :] - offsets_m[:, None]  # from i to j
    length = np.hypot(along[..., 0], along[..., 1])
    beside = along[:, :, None, 0] * along[:, None, :, 1] - along[:, :, None, 1] * along[:, None, :, 0]
    hull = (beside.min(axis=2) > -0.5 * pitch_m**2) & (length > 0.0)
    if not hull.any():
        return float(np.hypot(*offsets_m[0])), 0, 0
    outside = (along[..., 0] * offsets_m[:, None, 1] - along[..., 1] * offsets_m[:, None, 0]) / np.where(
        length > 0.0, length, 1.0
    )
    # of those that lie on one line the longest is the edge
    rated = np.where(hull, outside + 1e-9 * length, -np.inf)
    i, j = divmod(int(np.argmax(rated)), n)
    if beside.max() < 0.5 * pitch_m**2:
        ahead = -float(offsets_m[i] @ along[i, j]) / length[i, j]
        past = max(-ahead, ahead - float(length[i, j]))
        end = j if ahead > 0.0 else i
        off = abs(float(outside[i, j]))
        if past > off:
            return float(np.hypot(off, past)), end, end
        return float(np.hypot(off, max(past, 0.0))), i, j
    return float(outside[i, j]), i, j
