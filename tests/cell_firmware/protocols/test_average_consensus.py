from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.fault import FaultInstance
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import ParametersError
from cell_firmware.faults.kinds.link_down import LinkDownFault
from cell_firmware.faults.kinds.link_loss import LinkLossFault
from cell_firmware.protocols.average_consensus import AverageConsensus, AverageConsensusParameters

VALUES = [{"columns": [0, 1], "value": 3.0}, {"cell": [2, 3], "value": -5.0}]


def averaging(**parameters: Any) -> AverageConsensus:
    given = {"value": 0.5, "values": VALUES, **parameters}
    return AverageConsensus(AverageConsensusParameters.model_validate(given))


def given(lattice: Lattice) -> NDArray[np.float64]:
    values = np.where(lattice.columns < 2, 3.0, 0.5)
    values[lattice.index((2, 3))] = -5.0
    return values


def dense(lattice: Lattice, weight: str | float) -> NDArray[np.float64]:
    """The matrix of one step, link by link."""
    degree = (lattice.neighbours >= 0).sum(axis=1)
    matrix = np.eye(len(lattice))
    for i, side in zip(*np.nonzero(lattice.neighbours >= 0), strict=True):
        j = lattice.neighbours[i, side]
        w = 1.0 / (1 + max(degree[i], degree[j])) if weight == "metropolis" else weight
        matrix[i, j] += w
        matrix[i, i] -= w
    return matrix


@pytest.mark.parametrize("weight", ["metropolis", 0.22])
def test_every_tick_is_that_power_of_the_averaging_matrix(
    weight: str | float, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(5, 6, missing=[(1, 1), (3, 4)])
    seen = watch(averaging(weight=weight), lattice, 200)
    matrix, x = dense(lattice, weight), given(lattice)
    for k in range(200):
        np.testing.assert_allclose(seen[k], x, rtol=0, atol=1e-12, err_msg=f"tick {k}")
        x = matrix @ x


@pytest.mark.parametrize("weight", ["metropolis", 0.22])
def test_the_error_shrinks_by_the_spectrum_of_the_graph_laplacian(
    weight: str | float, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(5, 9, missing=[(2, 4)])
    firmware = averaging(weight=weight)
    theory = firmware.theory(lattice)
    values = np.sort(abs(np.linalg.eigvalsh(dense(lattice, weight))))
    assert theory.factor == pytest.approx(values[-2], rel=1e-12)
    error = watch(firmware, lattice, 400) - theory.limit
    size = np.sqrt((error**2).sum(axis=1))
    assert (size[400 - 1] / size[200]) ** (1 / 199) == pytest.approx(theory.factor, rel=1e-3)


def test_above_its_limit_a_constant_weight_grows_as_the_warning_says(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(4, 5)
    firmware = averaging(weight=0.32)
    (warning,) = firmware.warnings(lattice)
    seen = watch(firmware, lattice, 200)
    growth = np.linalg.norm(seen[-1]) / np.linalg.norm(seen[-2])
    assert f"grow by a factor of {growth:.6g} a tick" in warning
    assert averaging().warnings(lattice) == averaging(weight=0.25).warnings(lattice) == ()


@pytest.mark.parametrize(
    "effects",
    [
        {"link_loss": {"probability": 0.3}},
        {"link_delay": {"ticks": 3}},
        {"link_delay": {"between_ticks": [0, 4], "ordered": False}, "link_loss": {"probability": 0.1}},
    ],
)
@pytest.mark.parametrize("weight", ["metropolis", 0.25])
def test_the_mean_is_preserved_whatever_links_lose_or_delay(
    effects: dict[str, Any], weight: Any, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(4, 6, missing=[(1, 1)])
    enabled = CellEffects.model_validate(effects)
    seen = watch(averaging(weight=weight, ttl_periods=40), lattice, 2500, effects=enabled, seed=3)
    np.testing.assert_allclose(seen[-1], given(lattice).mean(), rtol=0, atol=1e-9)
    assert abs(seen[20].sum() - given(lattice).sum()) > 1e-3  # on the way it is not


ALL_LINKS = {"share": 1.0}


def silenced(
    lockstep: Any,
    firmware: AverageConsensus,
    lattice: Lattice,
    faults: list[FaultInstance[Any]],
    seed: int = 0,
) -> Callable[[int], NDArray[np.float64]]:
    """Steps cells whose links these faults affect; each call gives the estimates of so many ticks, ``(ticks, n)``."""
    steps = lockstep(firmware, Partition.even(lattice, 1), seed=seed, faults=faults)

    def go(ticks: int) -> NDArray[np.float64]:
        seen: list[NDArray[np.float64]] = []
        for _ in range(ticks):
            steps.step()
            seen.append(steps.shards[0].registers()[1]["firmware.value"])
        return np.array(seen)

    return go


def instance(lattice: Lattice, fault: Any, first: int, end: int, number: int = 0) -> FaultInstance[Any]:
    return FaultInstance(number, fault, np.arange(len(lattice)), first, end)


def test_bursts_of_losses_longer_than_the_patience_leave_the_mean_exact_while_they_go_on(
    lockstep: Any,
) -> None:
    """24 arrays with bursts of their own, no link between them; a burst takes seven times the ttl_periods in the
    mean."""
    arrays, rows, columns = 24, 3, 5
    lattice = Lattice((a * 4 + r, c) for a in range(arrays) for r in range(rows) for c in range(columns))
    firmware = averaging(value=0.0, values=[{"columns": [0, 0], "value": 1.0}], ttl_periods=3)
    bursts = LinkLossFault.model_validate({"probability": 0.2, "burst_ticks": 20.0, **ALL_LINKS})
    go = silenced(lockstep, firmware, lattice, [instance(lattice, bursts, 0, 10_000)], seed=5)
    error = abs(go(2000).reshape(2000, arrays, -1) - 1 / columns).max(axis=2)
    assert error[:200].max() > 0.5  # until cells know how long silences last
    assert error[-100:].max() < 1e-9, np.sort(error[-100:].max(axis=0))


def test_a_silence_that_a_cell_has_known_to_end_leaves_no_trace_when_it_comes_again(lockstep: Any) -> None:
    lattice, firmware = (
        Lattice((r, c) for r in range(3) for c in range(4)),
        averaging(ttl_periods=5, values=VALUES[:1]),
    )
    down = LinkDownFault.model_validate(ALL_LINKS)
    faults = [instance(lattice, down, 300, 400, 0), instance(lattice, down, 800, 1100, 1)]
    go = silenced(lockstep, firmware, lattice, faults)
    v = np.where(lattice.columns < 2, 3.0, 0.5)
    np.testing.assert_allclose(go(300)[-1], v.mean(), rtol=0, atol=1e-9)
    assert (go(100)[-1] == v).all()  # never known: all is called in
    np.testing.assert_allclose(go(400)[-1], v.mean(), rtol=0, atol=1e-9)
    np.testing.assert_allclose(go(600), v.mean(), rtol=0, atol=1e-9)  # three times as long as the first


def test_a_neighbour_counts_as_gone_after_four_times_the_longest_silence_that_ended(lockstep: Any) -> None:
    """Two cells; the word of the last tick before a silence still comes."""
    lattice, firmware = (
        Lattice([(0, 0), (0, 1)]),
        averaging(ttl_periods=5, value=0.0, values=[{"cell": [0, 0], "value": 1.0}]),
    )
    down = LinkDownFault.model_validate(ALL_LINKS)
    faults = [instance(lattice, down, 50, 80, 0), instance(lattice, down, 200, 1000, 1)]
    seen = silenced(lockstep, firmware, lattice, faults)(400)
    alone, together = (1.0, 0.0), (0.5, 0.5)
    for tick, right in [(49, together), (53, together), (54, alone), (79, alone), (199, together)]:
        np.testing.assert_allclose(seen[tick], right, rtol=0, atol=1e-9, err_msg=f"tick {tick}")
    np.testing.assert_allclose(seen[200 + 4 * 30 - 2], together, rtol=0, atol=1e-9)
    np.testing.assert_allclose(seen[200 + 4 * 30 - 1], alone, rtol=0, atol=1e-9)


def test_cells_that_receive_their_first_message_late_count_no_silence_before(lockstep: Any) -> None:
    """Words that take long to come are no silence: nothing was lent before the first."""
    lattice, firmware = Lattice([(0, 0), (0, 1)]), averaging(ttl_periods=5)
    down = LinkDownFault.model_validate(ALL_LINKS)
    steps = lockstep(firmware, Partition.even(lattice, 1), faults=[instance(lattice, down, 0, 60)])
    for _ in range(100):
        steps.step()
    assert steps.shards[0].registers()[1]["firmware.longest"].tolist() == [0, 0]


def test_those_who_live_come_to_their_own_mean(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    """Two cells die long after much has flown through them, and the others part into two groups."""
    lattice = grid(2, 6)
    firmware = averaging(ttl_periods=5, values=VALUES[:1])
    seen = watch(firmware, lattice, 1500, dead={60: [(0, 3), (1, 3)]})
    v = np.where(lattice.columns < 2, 3.0, 0.5)
    for group in (lattice.columns < 3, lattice.columns > 3):
        np.testing.assert_allclose(seen[-1, group], v[group].mean(), rtol=0, atol=1e-12)


def test_the_share_of_sensors_that_see_a_parcel_is_averaged_and_followed(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(4, 4)
    presence = np.zeros((800, 16, 1), dtype=np.bool_)
    presence[:400, :4] = True
    presence[400:, 3:15] = True
    seen = watch(averaging(source="presence"), lattice, 800, presence=presence)
    np.testing.assert_allclose(seen[399], 4 / 16, atol=1e-9)
    np.testing.assert_allclose(seen[799], 12 / 16, atol=1e-9)


def test_wheels_run_at_the_velocity_times_the_estimate(
    grid: Callable[..., Lattice], run: Callable[..., Any], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(4, 4), averaging(velocity_m_s=[0.1, -0.2])
    drives = run(firmware, Partition.even(lattice, 3), 30).drives
    seen = watch(firmware, lattice, 30)
    assert (drives == seen[:, :, None] * np.array([0.1, -0.2])).all()


@pytest.mark.parametrize("shards", [3, 22])
def test_averages_are_the_same_to_the_last_bit_however_the_array_is_cut(
    shards: int, grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    """With losses one by one and in bursts, and a cell that dies."""
    lattice = grid(4, 6, missing=[(1, 1), (3, 4)])
    firmware = averaging(velocity_m_s=[0.1, -0.2], ttl_periods=3)
    bursts = LinkLossFault.model_validate({"probability": 0.2, "burst_ticks": 6.0, **ALL_LINKS})
    options: dict[str, Any] = {
        "effects": CellEffects.model_validate({"link_loss": {"probability": 0.2}}),
        "faults": [instance(lattice, bursts, 0, 10_000)],
        "dead": {30: [(2, 2)]},
    }
    whole = run(firmware, Partition.even(lattice, 1), 60, **options).drives
    assert run(firmware, Partition.even(lattice, shards), 60, **options).drives.tobytes() == whole.tobytes()


def test_places_that_do_not_exist_are_reported(grid: Callable[..., Lattice]) -> None:
    with pytest.raises(ParametersError, match=r"values\[1\]\.cell: the array has no cell \[2, 3\]"):
        averaging().check(grid(2, 2))
