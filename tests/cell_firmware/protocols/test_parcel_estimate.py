"""A rectangle is moved over the cells by hand, and the cells are asked where they think that it is."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, Lattice
from bus.partition import Partition
from cell_firmware.estimation.estimator import MESSAGE
from cell_firmware.estimation.leader import UNKNOWN
from cell_firmware.firmware import Cells, Inbox, Inputs
from cell_firmware.protocols.parcel_estimate import ParcelEstimate, ParcelEstimateParameters
from tests.benchmarks.protocols.parcel_estimate_case import Case
from tests.benchmarks.protocols.parcel_estimate_case import run as run_case

SIZE_M = (0.42, 0.26)
PITCH_M, PERIOD_S = 0.1, 0.004096


def firmware(**parameters: Any) -> ParcelEstimate:
    return ParcelEstimate(
        ParcelEstimateParameters.model_validate({"size_m": SIZE_M, "target_m": [0.7, 0.7], **parameters})
    )


def over(lattice: Lattice, pose: tuple[float, float, float]) -> NDArray[np.bool_]:
    """``(n, 1)``: which cells' centres are under a rectangle."""
    x, y = lattice.columns * PITCH_M - pose[0], lattice.rows * PITCH_M - pose[1]
    along, across = np.cos(pose[2]) * x + np.sin(pose[2]) * y, np.cos(pose[2]) * y - np.sin(pose[2]) * x
    return ((abs(along) <= SIZE_M[0] / 2) & (abs(across) <= SIZE_M[1] / 2))[:, None]


def path(ticks: int) -> list[tuple[float, float, float]]:
    """A rectangle that goes to the upper right, and turns a little."""
    return [
        (0.35 + 0.1 * k * PERIOD_S, 0.35 + 0.06 * k * PERIOD_S, 0.3 + 0.1 * k * PERIOD_S)
        for k in range(ticks)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("shards", [3, 41])
def test_one_cell_does_alone_what_it_does_among_many(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
) -> None:
    lattice = grid(6, 7, missing=[(5, 6)])
    presence = np.array([over(lattice, pose) for pose in path(70)])
    dead = {40: [(4, 4), (5, 3)]}
    found = [
        run(firmware(), Partition.even(lattice, count), 70, presence=presence, dead=dead).drives
        for count in (1, shards)
    ]
    assert found[0].tobytes() == found[1].tobytes()
    assert np.any(found[0])


class Denied:
    """Raises whatever is asked of it."""

    def __getattribute__(self, name: str) -> Any:
        raise AssertionError(f"{name} is nothing that this protocol may see")


def test_nothing_is_read_but_sensors_and_messages(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, program = grid(9, 9), firmware()
    place = np.stack((lattice.columns, lattice.rows), axis=1).astype(np.float64) * PITCH_M
    whole = Cells.of(lattice, place, PERIOD_S, pitch_m=PITCH_M)
    denied: Any = Denied()
    state = program.init(replace(whole, has_neighbour=denied))
    neighbours, opposite = lattice.neighbours, np.array(OPPOSITE)
    sent, said = (
        np.zeros((len(lattice), 4), dtype=np.bool_),
        np.zeros((len(lattice), 4), dtype=program.message),
    )
    drives: list[NDArray[np.float64]] = []
    presence = np.array([over(lattice, pose) for pose in path(60)])
    for bits in presence:
        inbox = Inbox((neighbours >= 0) & sent[neighbours, opposite], said[neighbours, opposite])
        inbox.message[~inbox.received] = np.zeros((), dtype=program.message)
        state, outputs = program.step(state, Inputs(bits, denied, inbox, denied, denied, denied))
        assert outputs.outbox is not None
        sent, said = outputs.outbox.sent, outputs.outbox.message
        drives.append(outputs.speed_m_s)
    assert np.array_equal(
        np.array(drives), run(program, Partition.even(lattice, 1), 60, presence=presence).drives
    )


def shown(steps: Any) -> dict[str, NDArray[Any]]:
    """The cells' registers."""
    return {name.removeprefix("firmware."): array for name, array in steps.shards[0].registers()[1].items()}


def test_a_moving_parcel_is_known_to_a_few_millimetres_and_degrees_by_everybody_under_it(
    grid: Callable[..., Lattice], lockstep: Callable[..., Any]
) -> None:
    lattice = grid(12, 14)
    steps = lockstep(firmware(target_m=[3.0, 2.0]), Partition.even(lattice, 1))
    off: list[float] = []
    turned: list[float] = []
    for tick, (x, y, angle) in enumerate(path(700)):
        steps.step(over(lattice, (x, y, angle)))
        if tick >= 300:
            seen = shown(steps)
            knows = seen["covered"] & (seen["age"] < UNKNOWN)
            assert knows.sum() >= 0.8 * seen["covered"].sum()
            off.append(float(np.hypot(*(seen["centre_m"][knows] - (x, y)).T).max()))
            away = np.arctan2(seen["direction"][knows, 1], seen["direction"][knows, 0]) - angle
            turned.append(float(np.degrees(abs((away + np.pi / 2) % np.pi - np.pi / 2)).max()))
    assert np.sqrt(np.mean(np.square(off))) < 0.02
    assert np.sqrt(np.mean(np.square(turned))) < 4.0


def test_one_cell_leads_and_the_pose_is_known_in_the_time_that_theory_allows(
    grid: Callable[..., Lattice], lockstep: Callable[..., Any]
) -> None:
    lattice, pose = grid(10, 10), (0.45, 0.47, 0.4)
    steps = lockstep(firmware(), Partition.even(lattice, 1))
    width = 2 * 7
    for _ in range(width + 8 * 2 + width):
        steps.step(over(lattice, pose))
    seen = shown(steps)
    assert seen["leads"].sum() == 1
    assert (seen["age"][seen["covered"]] < UNKNOWN).all()
    assert np.hypot(*(seen["centre_m"][seen["leads"]][0] - pose[:2])) < 0.04


def test_cells_without_a_parcel_are_silent_and_stand_still(
    grid: Callable[..., Lattice], lockstep: Callable[..., Any]
) -> None:
    lattice = grid(8, 8)
    steps = lockstep(firmware(), Partition.even(lattice, 1))
    for pose in path(50):
        steps.step(over(lattice, pose))
    nothing = np.zeros((len(lattice), 1), dtype=np.bool_)
    for _ in range(300):
        steps.step(nothing)
    assert not np.any(steps.step(nothing))
    assert (shown(steps)["age"] == UNKNOWN).all()


@pytest.mark.parametrize(("dead_percent", "most_m"), [(0, 1e-3), (20, 0.03)])
def test_a_parcel_comes_to_rest_where_it_is_wanted(dead_percent: int, most_m: float) -> None:
    result = run_case(
        Case(SIZE_M, dead_percent=dead_percent, seeds=2, seconds=12.0, period_ns=16_384_000, sample_s=1.0)
    )
    assert np.hypot(result.truth[-1, :, 0], result.truth[-1, :, 1]).max() < most_m
    assert np.hypot(result.truth[0, :, 0], result.truth[0, :, 1]).min() > 0.2


def test_parcels_too_large_for_the_map_are_refused(grid: Callable[..., Lattice]) -> None:
    lattice = grid(4, 4)
    cells = Cells.of(lattice, np.zeros((16, 2)), PERIOD_S, pitch_m=PITCH_M)
    firmware(size_m=[0.8, 0.7]).init(cells)
    with pytest.raises(
        ValueError, match=r"size_m = \[0.9, 0.8\]: with 2 around them up to 17.0 cells in a row"
    ):
        firmware(size_m=[0.9, 0.8]).init(cells)


def test_what_a_message_takes_is_what_the_page_says() -> None:
    assert MESSAGE.itemsize == 95
