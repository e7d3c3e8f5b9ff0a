from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Cells
from cell_firmware.protocols.reserve_path import ReservePath
from cell_firmware.tiles.firmware import TileParameters
from cell_firmware.tiles.tiling import Tiling

EXIT = {"tile": [0, 1], "side": "east"}


def parameters(lanes: list[str], exits: list[dict[str, Any]], **others: Any) -> TileParameters:
    return TileParameters.model_validate({"lanes": lanes, "exits": exits, **others})


def test_the_first_line_of_lanes_is_the_northernmost_and_a_lane_in_is_the_other_end_of_a_lane_out() -> None:
    tiling = Tiling(parameters(["e s", "- ."], [EXIT]))
    assert list(tiling.tiles()) == [(0, 1), (1, 0), (1, 1)]
    assert tiling.out[1, 0].tolist() == [False, True, False, False]
    assert tiling.out[1, 1].tolist() == [False, False, True, False]
    assert tiling.into[1, 1].tolist() == [False, False, False, True]
    assert tiling.into[0, 1].tolist() == [True, False, False, False]
    assert (tiling.exit[0, 1], tiling.exit_side[0, 1], tiling.exit.sum()) == (1, 1, 1)


@pytest.mark.parametrize(
    ("lanes", "exits", "said"),
    [
        (["es ws", "en wn"], [EXIT], r"a ring, on which parcels might wait for each other: \[0, 0\] - "),
        (["e w", ". ."], [EXIT], r"a ring"),
        (["e e", ". ."], [EXIT], r"the lane east of tile \[1, 1\] leads to no tile"),
        (["e -", ". ."], [EXIT], r"the lane east of tile \[1, 0\] leads to no tile"),
        (["e", ". ."], [EXIT], "as many words in every line"),
        (["ee .", ". ."], [EXIT], "'ee' is none of"),
        (["e x", ". ."], [EXIT], "'x' is none of"),
        (["e .", ". ."], [EXIT, EXIT], r"tile \[0, 1\] is an exit already"),
        (["e .", ". -"], [EXIT], r"tile \[0, 1\] is none"),
    ],
)
def test_lanes_on_which_parcels_could_wait_for_ever_or_that_lead_nowhere_are_refused(
    lanes: list[str], exits: list[dict[str, Any]], said: str
) -> None:
    with pytest.raises(ValidationError, match=said):
        parameters(lanes, exits)


def test_a_tile_of_which_the_array_lacks_a_cell_is_refused_and_a_place_without_one_is_not(
    grid: Callable[..., Lattice],
) -> None:
    lattice = grid(4, 8, missing=[(2, 1), (3, 7)])
    with pytest.raises(ParametersError) as caught:
        ReservePath(parameters(["e ."], [EXIT])).check(lattice)
    assert [str(problem) for problem in caught.value.problems] == [
        "lanes: the array has no cell [2, 1] of tile [0, 0]; write '-' where there is no tile",
        "lanes: the array has no cell [3, 7] of tile [0, 1]; write '-' where there is no tile",
    ]
    ReservePath(parameters(["- ."], [EXIT])).check(grid(4, 8, missing=[(2, 1)]))


def test_cells_know_their_place_in_their_tile(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
) -> None:
    lattice = grid(3, 7)
    place = Tiling(parameters(["e ."], [EXIT], tile_cells=3)).place(everything(lattice))
    last = lattice.columns == 6  # beyond the tiles
    assert np.array_equal(place["used"], ~last)
    assert not place["mate"][last].any()
    middle, corner = lattice.index((1, 4)), lattice.index((2, 3))
    assert (place["rank"][middle], place["bit"][corner]) == (0, 1 << 6)
    np.testing.assert_allclose(place["offset_m"][corner], [-0.1, 0.1])
    assert place["mate"][corner].tolist() == [False, True, True, False]
    assert place["out"][lattice.index((2, 2))].tolist() == [False, True, False, False]
    assert sorted(place["rank"][lattice.columns < 3]) == list(range(9))


@pytest.mark.parametrize("least", [1, 8, 17])
def test_half_of_a_tile_can_not_go_on_alone(least: int) -> None:
    parameters(["e ."], [EXIT], least_cells=9)
    with pytest.raises(ValidationError, match="more than half of a tile's 16 cells"):
        parameters(["e ."], [EXIT], least_cells=least)
