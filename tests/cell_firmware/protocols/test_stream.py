from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.protocols.stream import Stream, StreamParameters

ENDS = [{"columns": [0, 0], "flow_m2_s": 0.02}, {"columns": [8, 8], "flow_m2_s": -0.02}]


def stream(**changes: Any) -> Stream:
    return Stream(StreamParameters.model_validate({"sources": ENDS, **changes}))


def outflow(lattice: Lattice, potential: NDArray[np.float64], gone: tuple[int, ...] = ()) -> list[float]:
    """Of every cell, through its four faces, one by one."""
    flows: list[float] = []
    for i, sides in enumerate(lattice.neighbours.tolist()):
        flows.append(sum(potential[i] - potential[j] for j in sides if j >= 0 and j not in gone))
    return flows


def test_at_rest_no_cell_but_sources_gives_or_takes_anything(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(6, 9, missing=[(2, 4), (3, 4), (2, 5)])
    potential = watch(stream(relaxation=1.8), lattice, 700)[-1]
    want = np.select([lattice.columns == 0, lattice.columns == 8], [0.02, -0.02], 0.0)
    np.testing.assert_allclose(outflow(lattice, potential), want, atol=1e-15)


def test_dead_cells_become_walls_that_the_stream_goes_round(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, dead = grid(5, 9), [(1, 4), (2, 4), (2, 5)]
    gone = tuple(lattice.index(cell) for cell in dead)
    firmware = stream(relaxation=1.8, ttl_periods=5)
    potential = watch(firmware, lattice, 900, dead={100: dead})[-1]
    flow = np.delete(outflow(lattice, potential, gone), gone)
    want = np.select([lattice.columns == 0, lattice.columns == 8], [0.02, -0.02], 0.0)
    np.testing.assert_allclose(flow, np.delete(want, gone), atol=1e-14)


def test_wheels_run_at_the_flow_through_their_faces_over_the_pitch(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    """A straight channel: 0.02 m2/s a row of 0.1 m is 0.2 m/s, half of it in the sources, which have one open face."""
    lattice = grid(3, 9)
    drives = run(stream(relaxation=1.7), Partition.even(lattice, 1), 500).drives[-1]
    want = np.where((lattice.columns == 0) | (lattice.columns == 8), 0.1, 0.2)
    np.testing.assert_allclose(drives, np.stack((want, 0 * want), axis=1), atol=1e-13)


def test_round_an_obstacle_wheels_run_along_it_faster_than_before_it(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice = grid(9, 9, missing=[(r, c) for r in (3, 4, 5) for c in (3, 4, 5)])
    drives = run(stream(relaxation=1.8), Partition.even(lattice, 1), 700).drives[-1]

    def at(row: int, column: int) -> list[float]:
        return drives[lattice.index((row, column))].tolist()

    assert at(2, 4)[0] > 0.25
    assert abs(at(2, 4)[1]) < 1e-12
    assert at(4, 2)[0] < 0.1
    assert abs(at(4, 2)[1]) < 1e-12
    assert at(3, 2)[1] < -0.02 < 0.02 < at(5, 2)[1]
    mirrored = drives.copy()
    for i, (row, column) in enumerate(lattice.cells):
        mirrored[i] = drives[lattice.index((8 - row, column))] * [1.0, -1.0]
    np.testing.assert_allclose(drives, mirrored, atol=1e-12)


@pytest.mark.parametrize("relaxation", [1.0, 1.5])
def test_potentials_settle_at_the_predicted_factor_to_the_predicted_limit(
    relaxation: float, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(4, 9, missing=[(1, 3)]), stream(relaxation=relaxation)
    theory = firmware.theory(lattice)
    error = np.sqrt(((watch(firmware, lattice, 301) - theory.limit) ** 2).sum(axis=1))
    assert (error[300] / error[150]) ** (1 / 150) == pytest.approx(theory.factor, rel=1e-4)


@pytest.mark.parametrize(
    ("effects", "relaxation"),
    [
        ({"link_loss": {"probability": 0.2}}, 1.0),
        ({"link_loss": {"probability": 0.2}}, 1.5),
        ({"link_delay": {"between_ticks": [0, 4]}}, 1.0),
    ],
)
def test_lost_and_late_messages_cost_time_alone(
    effects: dict[str, Any], relaxation: float, grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, firmware = grid(3, 9, missing=[(1, 4)]), stream(relaxation=relaxation)
    whole = Partition.even(lattice, 1)
    still = run(firmware, whole, 2000).drives[-1]
    enabled = CellEffects.model_validate(effects)
    np.testing.assert_allclose(run(firmware, whole, 2000, effects=enabled).drives[-1], still, atol=1e-7)


def test_sources_that_are_not_even_are_warned_of_and_every_cell_takes_its_share(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(3, 9), stream(sources=ENDS[:1])
    (warning,) = firmware.warnings(lattice)
    assert "27 cells about [0, 0] are 0.06 m2/s out of balance: each cell gains 0.00222222 m2/s" in warning
    assert firmware.theory(lattice).limit is None
    potential = watch(firmware, lattice, 1500)[-1]
    want = np.where(lattice.columns == 0, 0.02, 0.0) - 0.06 / 27
    np.testing.assert_allclose(outflow(lattice, potential), want, atol=1e-10)
    assert stream().warnings(lattice) == ()
    (warning,) = stream(diffusion_number=0.3).warnings(grid(9, 9))
    assert "potentials that alternate in sign" in warning


def test_the_stream_is_the_same_to_the_last_bit_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, firmware = grid(4, 9, missing=[(1, 3)]), stream(relaxation=1.5)
    whole = run(firmware, Partition.even(lattice, 1), 60, dead={20: [(3, 3)]}).drives
    for shards in (3, 35):
        cut = run(firmware, Partition.even(lattice, shards), 60, dead={20: [(3, 3)]}).drives
        assert cut.tobytes() == whole.tobytes()
