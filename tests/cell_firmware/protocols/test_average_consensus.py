from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import ParametersError
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


def test_above_its_limit_a_constant_weight_grows_as_the_caution_says(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(4, 5)
    firmware = averaging(weight=0.32)
    (caution,) = firmware.cautions(lattice)
    seen = watch(firmware, lattice, 200)
    growth = np.linalg.norm(seen[-1]) / np.linalg.norm(seen[-2])
    assert f"grow by a factor of {growth:.6g} a tick" in caution
    assert averaging().cautions(lattice) == averaging(weight=0.25).cautions(lattice) == ()


@pytest.mark.parametrize(
    "effects",
    [
        {"link_loss": {"probability": 0.3}},
        {"link_delay": {"ticks": 3}},
        {"link_delay": {"between_ticks": [0, 4], "ordered": False}, "link_loss": {"probability": 0.1}},
    ],
)
@pytest.mark.parametrize("weight", ["metropolis", 0.25])
def test_the_mean_is_kept_whatever_links_lose_or_delay(
    effects: dict[str, Any], weight: Any, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(4, 6, missing=[(1, 1)])
    asked = CellEffects.model_validate(effects)
    seen = watch(averaging(weight=weight, patience=40), lattice, 2500, effects=asked, seed=3)
    np.testing.assert_allclose(seen[-1], given(lattice).mean(), rtol=0, atol=1e-9)
    assert abs(seen[20].sum() - given(lattice).sum()) > 1e-3  # on the way it is not


def test_those_who_live_come_to_their_own_mean(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    """Two cells die long after much has flown through them, and the others part into two groups."""
    lattice = grid(2, 6)
    firmware = averaging(patience=5, values=VALUES[:1])
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
    lattice, firmware = grid(4, 6, missing=[(1, 1), (3, 4)]), averaging(velocity_m_s=[0.1, -0.2])
    effects = CellEffects.model_validate({"link_loss": {"probability": 0.2}})
    whole = run(firmware, Partition.even(lattice, 1), 60, effects=effects).drives
    assert run(firmware, Partition.even(lattice, shards), 60, effects=effects).drives.tobytes() == (
        whole.tobytes()
    )


def test_places_that_do_not_exist_are_told(grid: Callable[..., Lattice]) -> None:
    with pytest.raises(ParametersError, match=r"values\[1\]\.cell: the array has no cell \[2, 3\]"):
        averaging().check(grid(2, 2))
