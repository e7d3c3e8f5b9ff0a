import numpy as np

from bus.lattice import Lattice
from cell_firmware.toolkit.graph import components, hop_distance, reachable_maximum

WALLED = Lattice((r, c) for r in range(3) for c in range(5) if c != 2 or r == 0)
SPLIT = Lattice((r, c) for r in range(2) for c in range(5) if c != 2)


def test_steps_go_round_what_is_missing_and_count_from_the_nearest() -> None:
    steps = hop_distance(WALLED, np.array([WALLED.index((2, 1))]))
    by_cell = dict(zip(WALLED.cells, steps.tolist(), strict=True))
    assert [by_cell[cell] for cell in ((2, 1), (0, 1), (0, 2), (0, 3), (2, 3), (2, 4), (2, 0))] == [
        0, 2, 3, 4, 6, 7, 1,
    ]  # fmt: skip
    both = hop_distance(WALLED, np.array([WALLED.index((2, 1)), WALLED.index((2, 3))]))
    assert both[WALLED.index((2, 4))] == 1
    assert hop_distance(SPLIT, np.array([0])).tolist() == [0, 1, -1, -1, 1, 2, -1, -1]


def test_every_part_has_the_greatest_of_its_own_for_a_leader() -> None:
    key = np.array([5, 1, 7, 2, 3, 4, 0, 6])
    assert reachable_maximum(SPLIT, key).tolist() == [0, 0, 2, 2, 0, 0, 2, 2]
    assert components(SPLIT).tolist() in ([0, 0, 1, 1, 0, 0, 1, 1], [1, 1, 0, 0, 1, 1, 0, 0])
    assert components(WALLED).tolist() == [0] * len(WALLED)
