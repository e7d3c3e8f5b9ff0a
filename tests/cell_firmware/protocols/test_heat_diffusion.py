from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Cells
from cell_firmware.protocols.heat_diffusion import HeatDiffusion, HeatDiffusionParameters

HEAT: dict[str, Any] = {
    "diffusion_number": 0.23,
    "speed_m_s": [0.05, -0.02],
    "initial": [{"cell": [2, 3], "speed_m_s": [1.0, -0.5]}, {"cell": [4, 1], "speed_m_s": [-0.3, 0.7]}],
    "held": [{"cell": [0, 0], "speed_m_s": [0.4, 0.1]}, {"cell": [4, 5], "speed_m_s": [-0.2, 0.0]}],
}


EMPTY: dict[str, Any] = {"initial": [], "held": []}


def heat(**changes: Any) -> HeatDiffusion:
    return HeatDiffusion(HeatDiffusionParameters.model_validate({**HEAT, **changes}))


def matrix(lattice: Lattice, number: float, held: list[int]) -> NDArray[np.float64]:
    """One step of the explicit scheme, from the lattice's Laplacian; held cells have the identity's rows."""
    n = len(lattice)
    m = np.eye(n)
    for i in range(n):
        for j in lattice.neighbours[i]:
            if j >= 0 and i not in held:
                m[i, j] += number
                m[i, i] -= number
    return m


def initial(lattice: Lattice, spec: dict[str, Any]) -> NDArray[np.float64]:
    u = np.tile(np.array(spec["speed_m_s"]), (len(lattice), 1))
    for item in spec["initial"] + spec["held"]:
        u[lattice.index(tuple(item["cell"]))] = item["speed_m_s"]
    return u


def test_every_tick_is_that_power_of_the_discrete_heat_matrix(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    """The wheels of tick k run at ``M^k u[0]``: tick 0 at the initial speeds, tick 1 after one step."""
    lattice = grid(5, 6, missing=[(1, 1), (3, 4)])
    m = matrix(lattice, 0.23, [lattice.index((0, 0)), lattice.index((4, 5))])
    u0 = initial(lattice, HEAT)
    drives = run(heat(), Partition.even(lattice, 1), 300).drives
    for k in range(300):
        np.testing.assert_allclose(
            drives[k], np.linalg.matrix_power(m, k) @ u0, rtol=0, atol=1e-12, err_msg=f"tick {k}"
        )


@pytest.mark.parametrize("shards", [2, 3, 7, 28])
def test_heat_is_the_same_to_the_last_bit_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
):
    lattice = grid(5, 6, missing=[(1, 1), (3, 4)])
    whole = run(heat(), Partition.even(lattice, 1), 40).drives
    cut = run(heat(), Partition.even(lattice, shards), 40).drives
    assert cut.tobytes() == whole.tobytes()


def test_an_array_without_held_cells_keeps_its_mean_and_goes_flat(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(3, 3)
    drives = run(
        heat(held=[], initial=[{"cell": [0, 0], "speed_m_s": [9.0, -9.0]}], speed_m_s=[0.0, 0.0]),
        Partition.even(lattice, 1),
        400,
    ).drives
    np.testing.assert_allclose(drives.mean(axis=1), np.tile([1.0, -1.0], (400, 1)), atol=1e-12)
    np.testing.assert_allclose(drives[-1], np.tile([1.0, -1.0], (9, 1)), atol=1e-6)


def test_between_held_cells_the_profile_becomes_the_straight_line_of_steady_conduction(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(1, 5)
    held = [{"cell": [0, 0], "speed_m_s": [0.0, 4.0]}, {"cell": [0, 4], "speed_m_s": [4.0, 0.0]}]
    drives = run(heat(held=held, initial=[]), Partition.each(lattice), 600).drives
    np.testing.assert_allclose(drives[-1, :, 0], [0, 1, 2, 3, 4], atol=1e-9)
    np.testing.assert_allclose(drives[-1, :, 1], [4, 3, 2, 1, 0], atol=1e-9)


def test_a_dead_cell_insulates_from_the_tick_after_its_last_message(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    """The cell dies before tick 6: what it sent in tick 5 still counts in tick 6, and nothing after."""
    lattice = grid(1, 5)
    spec = {"held": [], "initial": [{"cell": [0, 0], "speed_m_s": [1.0, 0.0]}], "speed_m_s": [0.0, 0.0]}
    drives = run(heat(**spec), Partition.even(lattice, 1), 400, dead={6: [(0, 2)]}).drives
    m = matrix(lattice, 0.23, [])
    without = matrix(Lattice([(0, 0), (0, 1), (0, 3), (0, 4)]), 0.23, [])
    u = initial(lattice, {"speed_m_s": [0.0, 0.0], "initial": spec["initial"], "held": []})
    alive = [0, 1, 3, 4]
    for k in range(400):
        if k in range(1, 7):
            u = m @ u
        elif k > 6:
            u[alive] = without @ u[alive]
        np.testing.assert_allclose(drives[k, alive], u[alive], rtol=0, atol=1e-12, err_msg=f"tick {k}")
        assert (drives[k, 2] == 0).all() == (k >= 6 or k < 2)
    np.testing.assert_allclose(
        drives[-1, [0, 3]], [u[[0, 1]].mean(axis=0), u[[3, 4]].mean(axis=0)], atol=1e-9
    )


def test_above_what_an_array_bears_speeds_grow_at_the_rate_that_the_warning_says(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(5, 6, missing=[(1, 1)])
    firmware = heat(diffusion_number=0.3)
    (warning,) = firmware.warnings(lattice)
    factor = firmware.theory(lattice).factor
    assert factor is not None
    assert f"grow by a factor of {factor:.6g} a tick, without bound" in warning
    assert 1.1 < factor < 1.4
    drives = run(firmware, Partition.even(lattice, 1), 400).drives
    size = np.sqrt((drives**2).sum(axis=(1, 2)))
    np.testing.assert_allclose(size[-50:] / size[-51:-1], factor, rtol=1e-9)
    free = drives[-1, :, 0][(lattice.rows + lattice.columns) % 2 == 0]
    assert (np.sign(drives[-2, :, 0]) == -np.sign(drives[-1, :, 0]))[1:-1].all()
    assert abs(np.sign(free).sum()) >= len(free) - 2  # a chequerboard


def test_between_a_quarter_and_what_an_array_bears_it_settles_but_overshoots(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(3, 3)
    bears = 2.0 / 6.0  # the Laplacian of 3 x 3 cells has eigenvalues 0, 1, 3 along a row, and their sums
    start: dict[str, Any] = {"held": [], "initial": [{"cell": [1, 1], "speed_m_s": [1.0, 0.0]}]}
    firmware = heat(diffusion_number=0.32, speed_m_s=[0.0, 0.0], **start)
    (warning,) = firmware.warnings(lattice)
    assert f"this array bears {bears:.6g}, but speeds may overshoot" in warning
    drives = run(firmware, Partition.even(lattice, 1), 400).drives
    assert drives.min() < -0.2
    np.testing.assert_allclose(drives[-1, :, 0], 1.0 / 9.0, atol=1e-9)
    assert heat(diffusion_number=0.25).warnings(lattice) == ()


def test_the_slowest_error_shrinks_at_the_predicted_factor_towards_the_predicted_limit(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(5, 6, missing=[(1, 1), (3, 4)])
    theory = heat().theory(lattice)
    drives = run(heat(), Partition.even(lattice, 3), 260).drives
    error = np.sqrt(((drives - theory.limit) ** 2).sum(axis=(1, 2)))
    np.testing.assert_allclose(error[-60:] / error[-61:-1], theory.factor, rtol=1e-4)


def test_with_patience_lost_messages_leave_no_trace_between_held_cells(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(5, 6)
    effects = CellEffects(link_loss=LinkLossSpec(probability=0.3))

    def left(ttl_periods: int) -> float:
        firmware = heat(ttl_periods=ttl_periods)
        drives = run(firmware, Partition.even(lattice, 1), 2000, effects=effects, seed=5).drives
        return float(abs(drives[-1] - firmware.theory(lattice).limit).max())

    assert left(1) > 1e-3
    assert left(20) < 1e-12


def test_a_block_of_cells_is_each_of_them():
    block: list[dict[str, Any]] = [{"rows": [1, 2], "columns": [0, 1], "speed_m_s": [0.4, 0.1]}]
    each = [{"cell": [r, c], "speed_m_s": [0.4, 0.1]} for r in (1, 2) for c in (0, 1)]
    lattice = Lattice((r, c) for r in range(4) for c in range(4))
    cells = Cells.of(lattice, np.zeros((16, 2)), 0.004)
    for name in ("initial", "held"):
        of_block, of_each = (heat(**{**EMPTY, name: named}).init(cells) for named in (block, each))
        assert all((of_block[key] == of_each[key]).all() for key in of_each)
        assert (of_block["speed_m_s"] == [0.4, 0.1]).all(axis=1).sum() == 4


def test_cells_that_do_not_exist_are_all_named(grid: Callable[..., Lattice]):
    firmware = heat(held=[{"cell": [0, 9], "speed_m_s": [0, 0]}, {"cell": [1, 1], "speed_m_s": [0, 0]}])
    with pytest.raises(ParametersError) as caught:
        firmware.check(grid(5, 6, missing=[(1, 1)]))
    assert [str(problem) for problem in caught.value.problems] == [
        "held[0].cell: the array has no cell [0, 9]",
        "held[1].cell: the array has no cell [1, 1]",
    ]


@pytest.mark.parametrize("ticks", [1, 4])
def test_over_slow_links_the_flat_end_weighs_a_cell_by_one_plus_what_it_has_in_flight(
    ticks: int, grid: Callable[..., Lattice], run: Callable[..., Any]
):
    """What is kept is the sum of all speeds and, for each link, of ``r`` times the last ``d`` speeds of its source."""
    lattice = grid(3, 4, missing=[(1, 1)])
    hot: dict[str, Any] = {**HEAT, "initial": [{"cell": [0, 0], "speed_m_s": [1.0, -0.5]}], "held": []}
    effects = CellEffects(link_delay=LinkDelaySpec(ticks=ticks))
    end = run(heat(**hot), Partition.even(lattice, 1), 2000, effects=effects).drives[-1]
    weight = 1.0 + 0.23 * ticks * (lattice.neighbours >= 0).sum(axis=1)
    start = initial(lattice, hot)
    flat = weight @ start / weight.sum()
    np.testing.assert_allclose(end, np.tile(flat, (len(lattice), 1)), rtol=0, atol=1e-12)
    assert abs(flat - start.mean(axis=0)).max() > 1e-3  # not what quick links keep


def test_where_messages_get_lost_speeds_are_those_of_slower_conduction_on_average(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    """Losses are independent of what was sent: the mean over seeds is the power of the mean matrix."""
    lattice, loss, ticks, seeds = grid(3, 4), 0.3, 25, 200
    firmware = heat(initial=[], held=[{"cell": [0, 0], "speed_m_s": [1.0, 0.0]}], speed_m_s=[0.0, 0.0])
    effects = CellEffects(link_loss=LinkLossSpec(probability=loss))
    ends = np.array(
        [
            run(firmware, Partition.even(lattice, 1), ticks, effects=effects, seed=seed).drives[-1, :, 0]
            for seed in range(seeds)
        ]
    )
    slower, as_they_are = (
        np.linalg.matrix_power(matrix(lattice, number, [0]), ticks - 1)[:, 0]
        for number in (0.23 * (1 - loss), 0.23)
    )
    error = ends.std(axis=0) / np.sqrt(seeds)
    assert (abs(ends.mean(axis=0) - slower) <= 4.0 * error).all()
    assert (abs(as_they_are - slower)[1:] > 8.0 * error[1:]).all()


@pytest.mark.parametrize("ordered", [True, False])
def test_no_link_takes_a_speed_out_of_the_range_in_which_all_began(
    ordered: bool, grid: Callable[..., Lattice], run: Callable[..., Any]
):
    """Each step is a mean with weights of at least 0, whatever comes and however old: stable up to r = 1/4."""
    lattice = grid(3, 4)
    effects = CellEffects(
        link_loss=LinkLossSpec(probability=0.3),
        link_delay=LinkDelaySpec(between_ticks=(0, 6), ordered=ordered),
    )
    firmware = heat(diffusion_number=0.25, held=[], initial=[{"cell": [1, 1], "speed_m_s": [1.0, -1.0]}])
    drives = run(firmware, Partition.even(lattice, 1), 300, effects=effects, seed=3).drives
    rounding = 1e-15
    assert (drives[..., 0] >= 0.05 - rounding).all()
    assert (drives[..., 0] <= 1.0 + rounding).all()
    spread = np.ptp(drives, axis=1)[:, 0]
    assert spread[-1] < 1e-3 * spread[0]
