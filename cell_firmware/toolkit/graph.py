"""Spectra of an array's links, and steady states on them: limits and convergence rates of linear protocols.

Everything is about ``L = D - A``, the Laplacian of the cells that are free, held cells being its boundary: a link to
a held cell counts in the diagonal, and nowhere else.

Source: Chung, *Spectral Graph Theory*, AMS 1997; Xiao & Boyd, "Fast linear iterations for distributed averaging",
Systems & Control Letters 53 (2004).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice

Ints = NDArray[np.int64]
_FACING: Final = np.array([2, 3, 0, 1])
"""Of each side, the one of the neighbour there that faces it."""


def hop_distance(lattice: Lattice, cells: Ints, passes: NDArray[np.bool_] | None = None) -> Ints:
    """Return the distance from each cell to the nearest of ``cells``, hops.

    Args:
        lattice: The cells.
        cells: Indices of the cells to reach.
        passes: ``(n, 4)``, whether the link from a cell on the side may be used; None: all.

    Returns:
        ``(n,)``; -1 where no way leads there.
    """
    steps = np.full(len(lattice), -1)
    front, count = np.unique(cells), 0
    while len(front):
        steps[front] = count
        near = lattice.neighbours[front]
        # the way is walked backwards: from there to here, over the side that faces this one
        usable = (near >= 0) & (True if passes is None else passes[near, _FACING])
        front = np.unique(near[usable & (steps[near] < 0)])
        count += 1
    return steps


def reachable_maximum(lattice: Lattice, key: Ints) -> Ints:
    """``(n,)``: for each cell the index of the one with the greatest key that it can reach; keys differ."""
    leader = np.full(len(lattice), -1)
    for cell in np.argsort(-key):
        if leader[cell] < 0:
            leader[hop_distance(lattice, np.array([cell])) >= 0] = cell
    return leader


def components(lattice: Lattice) -> Ints:
    """``(n,)``: the number of the part of the array that a cell is in, from 0, of cells that can reach each other."""
    return np.unique(reachable_maximum(lattice, np.arange(len(lattice))), return_inverse=True)[1]


Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

_DENSE: Final = 400
"""Cells up to which a matrix is taken whole."""


@final
@dataclass(frozen=True, slots=True)
class Spectrum:
    """The ends of a Laplacian's spectrum.

    Attributes:
        least: The least eigenvalue of a part of the array that is not the 0 of a part without held cells.
            None where every part is one free cell by itself.
        greatest: The greatest eigenvalue.
        unanchored: ``(n,)``: free cells that no chain of links joins to a held one.
    """

    least: float | None
    greatest: float
    unanchored: Bools


@final
class GraphLaplacian:
    """The links of an array with their weights, and which of its cells are held.

    Args:
        lattice: The cells.
        held: ``(n,)``: does the cell keep its value?
        weight: ``(n, 4)``, of the link on each side, alike for both its ends; default: 1.
        of_cell: ``(n,)``, s in ``S L S``, S = diag(s), whose spectrum is computed; default: 1. With 1 / sqrt(degree)
            it is the normalised Laplacian.

    Attributes:
        laplacian: L of all cells, sparse.
        unanchored: ``(n,)``: free cells that no chain of links joins to a held one.
    """

    def __init__(
        self,
        lattice: Lattice,
        held: Bools | None = None,
        weight: Floats | None = None,
        of_cell: Floats | None = None,
    ) -> None:
        sparse: Any = _scipy("sparse")
        csgraph: Any = _scipy("sparse.csgraph")
        n = len(lattice)
        self.held = np.zeros(n, dtype=np.bool_) if held is None else held
        self._scale = np.ones(n) if of_cell is None else of_cell
        cell, side = np.nonzero(lattice.neighbours >= 0)
        weights = np.ones((n, 4)) if weight is None else weight
        links = weights[cell, side], (cell, lattice.neighbours[cell, side])
        joined: Any = sparse.coo_array(links, shape=(n, n)).tocsr()
        self.laplacian: Any = (sparse.diags_array(joined.sum(axis=1)) - joined).tocsr()
        self._free = np.flatnonzero(~self.held)
        between_free = joined[self._free][:, self._free]
        count, part = csgraph.connected_components(between_free, directed=False)
        self._part = np.full(n, -1)
        self._part[self._free] = part
        touches = joined[self._free][:, np.flatnonzero(self.held)].sum(axis=1) > 0
        self._anchored = np.bincount(part, touches, count) > 0
        self.unanchored: Bools = np.zeros(n, dtype=np.bool_)
        self.unanchored[self._free] = ~self._anchored[part]

    def spectrum(self) -> Spectrum:
        """Return the ends of the spectrum, over all parts into which held cells and gaps divide the array."""
        least: list[float] = []
        greatest = [0.0]
        for part, anchored in enumerate(self._anchored.tolist()):
            ends = self._ends(np.flatnonzero(self._part == part), anchored)
            least += ends[:1]
            greatest += ends[1:]
        return Spectrum(min(least, default=None), max(greatest), self.unanchored)

    def steady_state(self, value: Floats, poured: Floats | None = None) -> Floats:
        """The field in which what is poured into every free cell flows off to its neighbours, ``(n, ...)``.

        With nothing poured it is harmonic. A part without held cells keeps its mean, and what is poured into it beyond
        balance is left out.

        Args:
            value: ``(n, ...)``, of held cells; of the others, only the mean of a part without held ones matters.
            poured: ``(n, ...)``, into each cell; default: nothing.
        """
        spsolve: Any = _scipy("sparse.linalg").spsolve
        found = value.astype(np.float64)
        load = np.zeros_like(found) if poured is None else poured
        for part, anchored in enumerate(self._anchored.tolist()):
            cells = np.flatnonzero(self._part == part)
            rows: Any = self.laplacian[cells]
            inner: Any = rows[:, cells]
            if anchored:
                held = np.flatnonzero(self.held)
                right = load[cells] - rows[:, held] @ value[held]
                found[cells] = np.reshape(spsolve(inner.tocsc(), right), right.shape)
                continue
            mean = value[cells].mean(axis=0)
            found[cells] = mean
            if poured is not None and len(cells) > 1:  # one cell is set to 0, then all to the mean
                right = (load[cells] - load[cells].mean(axis=0))[1:]
                off = np.zeros_like(found[cells])
                off[1:] = np.reshape(spsolve(inner[1:][:, 1:].tocsc(), right), right.shape)
                found[cells] = mean + off - off.mean(axis=0)
        return found

    def _ends(self, cells: NDArray[np.int64], anchored: bool) -> list[float]:
        """Least and greatest eigenvalue of one part, without the 0 of one that is loose."""
        diags_array: Any = _scipy("sparse").diags_array
        zeros = 0 if anchored else 1
        if len(cells) <= zeros:
            return []
        scale: Any = diags_array(self._scale[cells])
        matrix: Any = scale @ self.laplacian[cells][:, cells] @ scale
        if len(cells) <= _DENSE:
            values = np.linalg.eigvalsh(matrix.toarray())
            return [float(values[zeros]), float(values[-1])]
        # by Gershgorin no eigenvalue is above twice the diagonal: both ends are the nearest to a point outside
        above = 2.0 * float(matrix.diagonal().max()) * (1.0 + 1e-6)
        return [_nearest(matrix, -1e-6 * above, zeros), _nearest(matrix, above, 0)]


def _scipy(part: str) -> Any:
    """A part of SciPy, imported where it is needed: it takes longer than a small array's spectrum."""
    return import_module(f"scipy.{part}")


def _nearest(matrix: Any, point: float, skipped: int) -> float:
    """The eigenvalue nearest to a point outside the spectrum, but for the ``skipped`` nearest."""
    eigsh: Any = _scipy("sparse.linalg").eigsh
    n: int = matrix.shape[0]
    start = np.cos(np.arange(n) * 0.7 + 0.1)  # the same answer every time
    values: list[float] = eigsh(
        matrix.tocsc(), k=1 + skipped, sigma=point, which="LM", v0=start, return_eigenvectors=False
    ).tolist()
    return float(sorted(values, key=lambda value: abs(float(value) - point))[skipped])


def convergence_factor(spectrum: Spectrum, number: float) -> float | None:
    """Factor of ``u - number L u``: by how much its slowest error shrinks, or grows, in a step.

    None where nothing is left to change.
    """
    if spectrum.least is None:
        return None
    return max(abs(1.0 - number * spectrum.least), abs(1.0 - number * spectrum.greatest))


def second_order(radius: float, relaxation: float) -> float:
    """Factor of ``u[k] = u[k-2] + w (M u[k-1] - u[k-2])``: the greater root of ``z^2 - w rho z + w - 1``.

    Args:
        radius: rho, the spectral radius of M, which is symmetric.
        relaxation: w, 1 to 2.
    """
    apart = relaxation * relaxation * radius * radius - 4.0 * (relaxation - 1.0)
    if apart < 0.0:
        return float(np.sqrt(relaxation - 1.0))
    return float(relaxation * radius + np.sqrt(apart)) / 2.0


def explicit_warnings(
    name: str, number: float, what: str, links: Callable[[], GraphLaplacian]
) -> tuple[str, ...]:
    """Return warnings of instability of ``u - number L u``: above 1/4, and above ``2 / lambda_max`` of the array.

    Args:
        name: Name of the parameter.
        number: Value of the parameter.
        what: Name of the values u, in the plural.
        links: Returns the array's Laplacian; called only if needed.
    """
    if number <= 0.25:
        return ()
    beyond = f"{name} {number:g} is above 1/4, the bound on four neighbours"
    grow = f"{what} that alternate in sign from cell to cell and from tick to tick grow"
    greatest = links().spectrum().greatest
    if number * greatest <= 2.0:
        bears = (
            f"this array bears {2.0 / greatest:.6g}, but {what} may overshoot the range in which they began"
        )
        return (f"{beyond}: {bears}, and grow where messages get lost or late",)
    over = f"and above {2.0 / greatest:.6g}, what this array bears"
    return (f"{beyond}, {over}: {grow} by a factor of {number * greatest - 1.0:.6g} a tick, without bound",)
