"""Ends of spectra and fields at rest, held to closed forms and to dense matrices."""

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.toolkit.graph import GraphLaplacian, convergence_factor


def block(rows: int, columns: int, missing: tuple[tuple[int, int], ...] = ()) -> Lattice:
    return Lattice((r, c) for r in range(rows) for c in range(columns) if (r, c) not in missing)


def rim(lattice: Lattice) -> NDArray[np.bool_]:
    return np.array([0 in cell or cell[0] == lattice.rows.max() or cell[1] == lattice.columns.max()
                     for cell in lattice.cells])  # fmt: skip


@pytest.mark.parametrize("n", [5, 19, 60])  # dense, dense, sparse
def test_a_square_has_the_eigenvalues_of_its_cosines(n: int) -> None:
    lattice = block(n, n)
    free = GraphLaplacian(lattice).spectrum()
    assert free.least == pytest.approx(2.0 - 2.0 * np.cos(np.pi / n), rel=1e-9)
    assert free.greatest == pytest.approx(4.0 - 4.0 * np.cos(np.pi * (n - 1) / n), rel=1e-12)
    assert free.unanchored.all()
    held = GraphLaplacian(lattice, rim(lattice)).spectrum()
    assert held.least == pytest.approx(4.0 - 4.0 * np.cos(np.pi / (n - 1)), rel=1e-9)
    assert held.greatest == pytest.approx(4.0 + 4.0 * np.cos(np.pi / (n - 1)), rel=1e-12)
    assert not held.unanchored.any()


def test_parts_that_held_cells_and_gaps_divide_each_count() -> None:
    """Of a row of nine with the fifth held and the eighth gone: four cells at a wall, two, and one alone."""
    lattice = block(1, 9, ((0, 7),))
    held = lattice.columns == 4
    found = GraphLaplacian(lattice, held).spectrum()
    four = 2.0 - 2.0 * np.cos(np.pi * (2 * np.arange(4) + 1) / 9)
    two = 2.0 - 2.0 * np.cos(np.pi * (2 * np.arange(2) + 1) / 5)
    assert found.least == pytest.approx(min(four.min(), two.min()), rel=1e-12)
    assert found.greatest == pytest.approx(max(four.max(), two.max()), rel=1e-12)
    assert np.flatnonzero(found.unanchored).tolist() == [7]


def test_where_nothing_is_free_or_linked_nothing_is_left_to_change() -> None:
    lattice = Lattice([(0, 0), (0, 2), (1, 1)])
    for held in (np.zeros(3, dtype=np.bool_), np.ones(3, dtype=np.bool_)):
        found = GraphLaplacian(lattice, held).spectrum()
        assert (found.least, found.greatest) == (None, 0.0)
        assert convergence_factor(found, 0.2) is None


def test_weights_and_scales_are_those_of_the_dense_matrix() -> None:
    lattice = block(5, 6, ((2, 2),))
    degree = (lattice.neighbours >= 0).sum(axis=1)
    weight = 1.0 / (1.0 + np.maximum(degree[:, None], degree[lattice.neighbours]))
    scale = 1.0 / np.sqrt(degree)
    dense = np.zeros((len(lattice), len(lattice)))
    for i, side in zip(*np.nonzero(lattice.neighbours >= 0), strict=True):
        dense[i, lattice.neighbours[i, side]] -= weight[i, side]
        dense[i, i] += weight[i, side]
    values = np.linalg.eigvalsh(scale[:, None] * dense * scale)
    found = GraphLaplacian(lattice, weight=weight, of_cell=scale).spectrum()
    assert (found.least, found.greatest) == pytest.approx((values[1], values[-1]), rel=1e-12)


def test_the_field_at_rest_balances_what_is_poured_into_every_cell() -> None:
    """Two parts: one with held cells, which fix it, and one without, whose mean stays and whose surplus is left out."""
    lattice = block(4, 9, tuple((r, 4) for r in range(4)))
    held = (lattice.columns == 0) | ((lattice.columns == 3) & (lattice.rows > 1))
    chance = np.random.default_rng(3)
    value, poured = chance.normal(size=(len(lattice), 2)), chance.normal(size=(len(lattice), 2))
    links = GraphLaplacian(lattice, held)
    found = links.steady_state(value, poured)
    assert (found[held] == value[held]).all()
    left = lattice.columns < 4
    off = links.laplacian @ found
    np.testing.assert_allclose(off[left & ~held], poured[left & ~held], atol=1e-12)
    np.testing.assert_allclose(off[~left], (poured - poured[~left].mean(axis=0))[~left], atol=1e-12)
    np.testing.assert_allclose(found[~left].mean(axis=0), value[~left].mean(axis=0), atol=1e-12)
    harmonic = links.steady_state(value)
    np.testing.assert_allclose((links.laplacian @ harmonic)[~held], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        harmonic[~left], value[~left].mean(axis=0)[None] * np.ones((16, 1)), atol=1e-12
    )
