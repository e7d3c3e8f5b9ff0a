"""TDMA slots: cells settle on slots of a frame that no cell within two hops has."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import OPPOSITE, SIDES, Lattice
from cell_firmware.array_view import ArrayView
from cell_firmware.firmware import Cells, State
from cell_firmware.kit.silence import aged
from cell_firmware.kit.slots import MOST_AROUND, UNKNOWN, free_slot, has_to_move, yields
from cell_firmware.program import Theory
from cell_firmware.scalar_program import ScalarProgram, scalar_function
from cell_firmware.specs import Spec
from cell_firmware.toolkit.hold import Ttl


class Distance2SlotsParameters(Spec):
    """Length of a frame, and the choice among free slots."""

    slots: Annotated[int, Field(gt=MOST_AROUND, le=62)] = 16
    """Slots of a frame."""
    choice: Literal["least", "random"] = "least"
    """Choice among free slots: the first, or any with the same probability."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods."""


@scalar_function
def settle(constants: Any, state: Any, inputs: Any, outputs: Any, draw: Any) -> None:
    """Hear, move if necessary, and tell the slots within one hop.

    Args:
        constants: Those of the program.
        state: The cell's.
        inputs: The cell's.
        outputs: The cell's.
        draw: Which of the free slots, 0 to 1.
    """
    for side in range(4):
        state.counts[side] = aged(inputs.received[side] != 0, state.counts[side], constants.ttl_periods)
        if inputs.received[side]:
            state.near[side] = inputs.message[side].slot
            state.beyond[side, 0] = inputs.message[side].north
            state.beyond[side, 1] = inputs.message[side].east
            state.beyond[side, 2] = inputs.message[side].south
            state.beyond[side, 3] = inputs.message[side].west
        if state.counts[side] == 0 or not 0 <= state.near[side] < constants.slots:
            state.near[side] = UNKNOWN
    in_frame = 0 <= state.slot < constants.slots
    if not in_frame or has_to_move(state.slot, state.counts, state.near, state.beyond):
        state.slot = free_slot(state.counts, state.near, state.beyond, constants.slots, draw)
        state.moves += 1
    for side in range(4):
        outputs.sent[side] = 1
        outputs.message[side].slot = state.slot
        outputs.message[side].north = state.near[0]
        outputs.message[side].east = state.near[1]
        outputs.message[side].south = state.near[2]
        outputs.message[side].west = state.near[3]


def _step_at_random(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
    settle(constants, state, inputs, outputs, inputs.random.slot)


@final
class Distance2Slots(ScalarProgram):
    """Self-stabilising colouring at distance two: two cells that share a neighbour never have the same slot.

    A cell sends its own slot and those that it has heard from its neighbours, so that it knows the slots within two
    hops. Of two cells with the same slot the one farther south, and then farther west, moves to a slot that is free as
    far as it knows.

    A cell that yields to nobody keeps its slot. Where all that a cell yields to keep theirs, the cell moves once more
    at most, whichever free slot it takes. So with ``A = ttl_periods``, on links that neither lose nor delay, all slots
    are final after ``2 A (h + 1) + 1`` ticks, h being the steps of the longest chain of cells each of which yields to
    the next: at most columns + 2 rows - 3.

    Source: T. Herman and S. Tixeuil, "A distributed TDMA slot assignment algorithm for wireless sensor networks",
    ALGOSENSORS 2004.
    """

    Parameters = Distance2SlotsParameters
    message = np.dtype([(name, "u1") for name in ("slot", *SIDES)])
    observable = "slot"
    is_brief = True
    compared_ticks: ClassVar[int] = 0
    constants_type = np.dtype([("slots", "<i8"), ("ttl_periods", "<i8")])
    state_type = np.dtype(
        [
            ("slot", "<i8"),
            ("moves", "<i8"),  # number of changes since the start
            ("counts", "<i8", (4,)),  # for how many periods a neighbour's message is valid
            ("near", "<i8", (4,)),  # the neighbours' slots
            ("beyond", "<i8", (4, 4)),  # the slots of each neighbour's neighbours
        ],
        align=True,
    )

    def __init__(self, parameters: Distance2SlotsParameters) -> None:
        super().__init__(parameters)
        if parameters.choice == "random":
            self.random = ("slot",)  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]

    def constants(self) -> Mapping[str, int]:
        """Return the length of a frame, and the validity of messages."""
        return {"slots": self.parameters.slots, "ttl_periods": self.parameters.ttl_periods}

    def init(self, cells: Cells) -> State:
        """Return the initial state: slot 0, and nothing heard."""
        n = len(cells)
        nothing = np.zeros(n, dtype=np.int64)
        return {
            "slot": nothing,
            "moves": nothing,
            "counts": np.zeros((n, 4), dtype=np.int64),
            "near": np.full((n, 4), UNKNOWN),
            "beyond": np.full((n, 4, 4), UNKNOWN),
        }

    def step_function(self) -> Callable[[Any, Any, Any, Any], None]:
        """Return the step: with random numbers, if slots are chosen at random."""
        return _step_at_random if self.parameters.choice == "random" else type(self).cell_step

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        """Move to the first free slot if necessary."""
        settle(constants, state, inputs, outputs, 0.0)

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        """Yield that slots are in the frame."""
        yield "a slot is in the frame", (view["slot"] >= 0) & (view["slot"] < self.parameters.slots)

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        """Yield that no two cells within two hops share a slot."""
        rows, columns = np.array(view.cells).T
        chain = int(np.ptp(columns)) + 2 * int(np.ptp(rows))
        yield (
            "no two cells within two hops share a slot",
            ~clashes(view["slot"], view.neighbours),
            2 * self.parameters.ttl_periods * (chain + 1) + 1,
        )

    def accepts(self, messages: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which messages a program may have sent: slots in the frame, or unknown ones of neighbours."""
        good = messages["slot"] < self.parameters.slots
        for name in SIDES:
            good &= (messages[name] < self.parameters.slots) | (messages[name] == UNKNOWN)
        return good

    def theory(self, lattice: Lattice) -> Theory:
        """Predict the ticks after which slots are final, from the longest chain of cells that yield."""
        chain = longest_chain(lattice)
        return Theory(
            "a cell moves once more at most after all that it yields to have settled",
            ticks=2 * self.parameters.ttl_periods * (chain + 1) + 1,
        )


def clashes(slot: NDArray[np.int64], neighbours: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether a cell has the slot of another one within two hops, ``(n,)``.

    Args:
        slot: ``(n,)``.
        neighbours: ``(n, 4)``, index of the neighbour on each side, or -1.
    """
    there = neighbours >= 0
    near = np.where(there, slot[neighbours], -1)
    found = (near == slot[:, None]).any(axis=1)
    beyond = np.where(there[:, :, None], near[neighbours], -1)
    for side in range(4):
        beyond[:, side, OPPOSITE[side]] = -1
    return found | (beyond == slot[:, None, None]).any(axis=(1, 2))


def longest_chain(lattice: Lattice) -> int:
    """Return the greatest number of hops-of-two in a chain of cells each of which yields to the next."""
    steps = [
        (side, other) for side in range(4) for other in range(5) if other == 4 or other != OPPOSITE[side]
    ]
    neighbours: list[list[int]] = lattice.neighbours.tolist()
    height = [0] * len(lattice)
    for cell in reversed(range(len(lattice))):  # a cell yields to later ones alone
        for side, other in steps:
            there = neighbours[cell][side]
            if there >= 0 and other < 4:
                there = neighbours[there][other]
            if there >= 0 and yields(side, other):
                height[cell] = max(height[cell], height[there] + 1)
    return max(height)
