from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.protocols.laplace import Laplace, LaplaceParameters

ENDS = [{"cell": [0, 0], "value": 1.0}, {"cell": [4, 6], "value": -1.0}]
PLATES = [{"columns": [0, 0], "value": 1.0}, {"rows": [1, 4], "columns": [6, 6], "value": -1.0}]


def laplace(**parameters: Any) -> Laplace:
    return Laplace(LaplaceParameters.model_validate({"held": ENDS, **parameters}))


def border(n: int) -> list[dict[str, Any]]:
    """Around n x n cells: one side at 1, the others at 0."""
    return [
        {"rows": [0, 0], "value": 1.0},
        {"rows": [n + 1, n + 1], "value": 0.0},
        {"rows": [1, n], "columns": [0, 0], "value": 0.0},
        {"rows": [1, n], "columns": [n + 1, n + 1], "value": 0.0},
    ]


def sizes(seen: NDArray[np.float64], limit: Any) -> NDArray[np.float64]:
    return np.sqrt(((seen - limit) ** 2).sum(axis=1))


@pytest.mark.parametrize(("n", "rounds"), [(4, 10.9), (8, 37.0), (16, 134.1), (32, 507.4)])
def test_jacobis_rounds_per_decade_of_error_are_those_of_the_square(
    n: int, rounds: float, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(n + 2, n + 2), laplace(held=border(n))
    theory = firmware.theory(lattice)
    assert theory.factor == pytest.approx(np.cos(np.pi / (n + 1)), rel=1e-9)
    first, last = 2 * round(0.6 * rounds), 2 * round(0.9 * rounds)
    error = sizes(watch(firmware, lattice, last + 1), theory.limit)
    measured = (last - first) / np.log10(error[first] / error[last])
    assert measured == pytest.approx(rounds, rel=0.01)


@pytest.mark.parametrize("relaxation", [1.0, 1.4, 1.6895, 1.9])
def test_the_second_order_method_shrinks_errors_as_its_theory_says(
    relaxation: float, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    """1.6895 is the best for 16 x 16: a decade takes 12.4 rounds instead of 134."""
    lattice, firmware = grid(18, 18), laplace(held=border(16), relaxation=relaxation)
    theory = firmware.theory(lattice)
    assert theory.factor is not None
    ticks = 300 if relaxation in (1.0, 1.9) else 160
    error = sizes(watch(firmware, lattice, ticks), theory.limit)
    # errors swing: the greatest of ten ticks; the last before rounding, against that of half as many
    crests = error[: ticks // 10 * 10].reshape(-1, 10).max(axis=1)
    last = np.flatnonzero(crests > 1e-12)[-1]
    span = np.log(crests[last] / crests[last // 2]) / (10 * (last - last // 2))
    # near the best relaxation the slowest errors are pairs that are almost one, and shrink as k times the power; above
    # it all shrink alike, and swing against each other
    near = {1.6895: 0.12, 1.9: 0.06}.get(relaxation, 0.02)
    assert span == pytest.approx(np.log(theory.factor), rel=near)


def test_the_potential_is_harmonic_and_goes_round_gaps_and_cells_that_died(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    gone = [(2, c) for c in range(1, 6)]
    lattice = grid(5, 7, missing=gone[:3])
    firmware = laplace(ttl_periods=5, held=PLATES)
    seen = watch(firmware, lattice, 900, dead={100: gone[3:]})
    around = grid(5, 7, missing=gone)
    limit = firmware.theory(around).limit
    assert limit is not None
    alive = [lattice.index(cell) for cell in around.cells]
    np.testing.assert_allclose(seen[-1, alive], limit, rtol=0, atol=1e-12)


LOSS = {"link_loss": {"probability": 0.2}}
DELAY = {"link_delay": {"between_ticks": [0, 4]}}


@pytest.mark.parametrize(("effects", "relaxation"), [(LOSS, 1.0), (LOSS, 1.5), (DELAY, 1.0)])
def test_lost_and_late_messages_cost_time_alone(
    effects: dict[str, Any], relaxation: float, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(5, 7), laplace(relaxation=relaxation, held=PLATES)
    seen = watch(firmware, lattice, 1200, effects=CellEffects.model_validate(effects), seed=1)
    np.testing.assert_allclose(seen[-1], firmware.theory(lattice).limit, rtol=0, atol=1e-10)


def test_no_potential_leaves_the_range_of_what_is_held_even_where_it_never_settles(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(5, 7), laplace(relaxation=1.8, held=PLATES)
    seen = watch(firmware, lattice, 600, effects=CellEffects.model_validate(DELAY), seed=1)
    assert abs(seen).max() == 1.0
    assert abs(seen[-100:] - firmware.theory(lattice).limit).max() > 0.1


def test_wheels_run_down_the_potential_to_its_sink_from_everywhere(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    """A point takes its cell's velocity, a tenth of the pitch at a time; it slides along walls."""
    lattice = grid(5, 7, missing=[(2, c) for c in range(1, 6)])
    drives = run(laplace(speed_m_s=0.2), Partition.even(lattice, 1), 2000).drives[-1]
    speed = np.sqrt((drives**2).sum(axis=1))
    np.testing.assert_allclose(speed[speed > 0], 0.2, rtol=1e-12)
    for start in lattice.cells:
        place = [float(start[0]), float(start[1])]
        for _ in range(400):
            velocity = drives[lattice.index((round(place[0]), round(place[1])))]
            for axis in (0, 1):
                moved = list(place)
                moved[axis] += 0.1 * velocity[1 - axis] / 0.2
                if (round(moved[0]), round(moved[1])) in lattice:
                    place = moved
        assert abs(np.array(place) - [4, 6]).max() < 0.7, start


def test_speed_may_go_by_the_slope(grid: Callable[..., Lattice], run: Callable[..., Any]) -> None:
    """Between two plates the slope is the same everywhere; half of the upper plate has none, and the lower stands."""
    lattice = grid(3, 6)
    held = [{"columns": [0, 0], "value": 5.0}, {"columns": [5, 5], "value": 0.0}]
    drives = run(laplace(held=held, gain_m2_s=0.02), Partition.even(lattice, 1), 800).drives[-1]
    want = np.array([0.1, 0.2, 0.2, 0.2, 0.2, 0.0])[lattice.columns]
    np.testing.assert_allclose(drives, np.stack((want, 0 * want), axis=1), atol=1e-12)


def test_what_cannot_work_is_warned_of_and_comes_true(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice = grid(3, 7, missing=[(r, 3) for r in range(3)])
    alone = laplace(held=[{"cell": [0, 0], "value": 1.0}, {"cell": [2, 2], "value": 0.0}], speed_m_s=0.2)
    assert alone.warnings(lattice) == (
        "9 cells have no route to a held cell: their potential stays 0, and their wheels stand",
    )
    flat = laplace(held=[{"rows": [0, 0], "value": 1.0}], speed_m_s=0.2)  # on its way there is a slope
    assert flat.warnings(lattice) == (
        "all held cells have the same potential: it becomes flat, and wheels stand",
    )
    right = lattice.columns > 3
    assert not run(alone, Partition.even(lattice, 1), 300).drives[:, right].any()
    assert not run(flat, Partition.even(lattice, 1), 2000).drives[-1].any()
    assert laplace().warnings(grid(5, 7)) == ()


def test_the_potential_is_the_same_to_the_last_bit_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, firmware = grid(5, 7, missing=[(2, 3)]), laplace(speed_m_s=0.2, relaxation=1.5)
    whole = run(firmware, Partition.even(lattice, 1), 60, dead={20: [(3, 3)]}).drives
    for shards in (3, 34):
        cut = run(firmware, Partition.even(lattice, shards), 60, dead={20: [(3, 3)]}).drives
        assert cut.tobytes() == whole.tobytes()


@pytest.mark.parametrize(
    ("wrong", "rule"),
    [
        ({"speed_m_s": 0.1, "gain_m2_s": 1.0}, "give speed_m_s or gain_m2_s, not both"),
        ({"relaxation": 2.0}, "less than 2"),
        ({"held": []}, "at least 1 item"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(wrong: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        laplace(**wrong)
