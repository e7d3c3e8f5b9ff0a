"""Fault ``lie``: cells that send plausible but false values to their neighbours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from bus.fault import CellTarget, FaultInstance, Problem, links_of
from bus.lattice import SIDES
from bus.random_streams import CounterStream
from bus.spec import Finite
from bus.wire.message_type import Leaf, clear_tails, leaves
from cell_firmware.errors import FirmwareError
from cell_firmware.faults.base import CellFault, stream_name
from cell_firmware.faults.message_fault import MessageContext, MessageFault
from cell_firmware.firmware import Bools, Inbox, State
from cell_firmware.message_values import bounds

if TYPE_CHECKING:
    from cell_firmware.specs import CellsSpec

Ints = NDArray[np.int64]
Values = NDArray[Any]


@final
class LieFault(CellTarget, CellFault):
    """Neighbours of lying cells receive false numbers.

    The numbers are replaced at the receivers: whole messages, beyond lines and framing.

    Modes: ``stuck``, the first value of the link while the fault is active; ``offset``, plus ``by``; ``factor``, times
    ``by``; ``random``, a value between the least and the greatest of the link while the fault is active, drawn for
    every neighbour and tick. Integers are rounded, and clipped to their field's range.
    """

    kind_name: ClassVar[str] = "lie"
    corrupts_messages: ClassVar[bool] = True
    kind: Literal["lie"] = "lie"
    mode: Literal["stuck", "offset", "factor", "random"]
    by: Finite | None = None
    """Number that is added (``offset``), or that multiplies (``factor``)."""
    field: str | None = None
    """Field of the message; None: all numeric fields, without booleans."""

    @model_validator(mode="after")
    def _by_what(self) -> Self:
        if (self.by is None) == (self.mode in ("offset", "factor")):
            raise ValueError(
                f"mode {self.mode} {'needs by' if self.by is None else 'takes no by; leave it out'}"
            )
        return self

    def fit_problems(self, cells: CellsSpec, sensors: int) -> Iterator[Problem]:
        """Yield a field that is no number of the firmware's messages."""
        del sensors
        from cell_firmware.loader import load

        try:
            message = load(cells).message
        except FirmwareError:
            return  # which is another problem
        named = [] if message is None else [leaf.name for leaf in _numbers(message)]
        if self.field is not None and self.field not in named:
            listed = ", ".join(named) or "none"
            yield ("field",), self.field, f"must be a numeric field of {cells.firmware}'s messages: {listed}"

    def message_faults(self, talk: MessageContext, injected: FaultInstance[CellFault]) -> MessageFault:
        """Return the changes to messages, applied at their receivers."""
        return _Lies(self, talk, injected)


@final
class _Lies(MessageFault):
    counts = "messages"

    def __init__(self, fault: LieFault, talk: MessageContext, injected: FaultInstance[CellFault]) -> None:
        lattice = talk.lattice
        affected = links_of(lattice, injected.cells, incoming=False, outgoing=True)
        super().__init__(injected, np.unique(affected[:, 0]))
        self._mode, self._by = fault.mode, 0.0 if fault.by is None else fault.by
        self._fields = [leaf for leaf in _numbers(talk.message) if fault.field in (None, leaf.name)]
        self._message = talk.message
        self._affected = np.zeros((len(lattice), len(SIDES)), dtype=np.bool_)
        self._affected[affected[:, 0], affected[:, 1]] = True
        self._draws: CounterStream | None = None
        if fault.mode == "random" and len(affected):
            self._links = affected
            self._draws = CounterStream(
                talk.seed, stream_name(injected), len(SIDES) * affected[:, 0] + affected[:, 1]
            )
        self._cells = len(lattice)

    def begin(self, cells: int) -> State:
        """Whether a link has brought anything, and the least and greatest of it; the first is both where it sticks."""
        if self._mode not in ("stuck", "random"):
            return {}
        shape = (cells, len(SIDES))
        return {
            "known": np.zeros(shape, dtype=np.bool_),
            "least": np.zeros(shape, dtype=self._message),
            "greatest": np.zeros(shape, dtype=self._message),
        }

    def on_receive(self, tick: int, own: State, place: Ints, inbox: Inbox) -> tuple[State, Inbox, Ints]:
        """Replace numbers in messages from lying cells."""
        lies = self._affected[place] & inbox.received
        message = np.array(inbox.message)
        if own:
            own = self._learnt(own, lies, inbox.message)
        chance = self._chance(tick, place)[lies]
        with np.errstate(over="ignore", invalid="ignore"):  # what is no number any more is refused
            for leaf in self._fields:
                numbers = leaf.of(message)
                numbers[lies] = self._instead(leaf, own, numbers[lies], lies, chance)
        clear_tails(message, self._message)
        return own, Inbox(inbox.received, message), lies.sum(axis=1)

    def _instead(
        self, leaf: Leaf, own: State, original: Values, lies: Bools, chance: NDArray[np.float64]
    ) -> Values:
        """Return the false values of a field."""
        if self._mode == "offset":
            return _shifted(original, self._by, leaf)
        if self._mode == "factor":
            return _times(original, self._by, leaf)
        least = leaf.of(own["least"])[lies]
        if self._mode == "stuck":
            return least
        chance = np.broadcast_to(chance.reshape(-1, *(1,) * len(leaf.shape)), least.shape)
        return _between(least, leaf.of(own["greatest"])[lies], chance, leaf)

    def _chance(self, tick: int, place: Ints) -> NDArray[np.float64]:
        """``(n, 4)``: a number for each link."""
        chance = np.zeros((self._cells, len(SIDES)))
        if self._draws is not None:
            chance[self._links[:, 0], self._links[:, 1]] = self._draws.uniform(tick)
        return chance[place]

    def _learnt(self, own: State, lies: Bools, message: Values) -> State:
        """Update the values that links have brought while the fault is active."""
        known, least, greatest = own["known"], np.array(own["least"]), np.array(own["greatest"])
        for leaf in self._fields:
            each = (*lies.shape, *(1,) * len(leaf.shape))
            lying, first = lies.reshape(each), (lies & ~known).reshape(each)
            values, lowest, highest = leaf.of(message), leaf.of(least), leaf.of(greatest)
            if self._mode == "stuck":
                lowest[...] = np.where(first, values, lowest)
                continue
            lowest[...] = np.where(first | (lying & (values < lowest)), values, lowest)
            highest[...] = np.where(first | (lying & (values > highest)), values, highest)
        return {"known": known | lies, "least": least, "greatest": greatest}


def _numbers(message: np.dtype[Any]) -> list[Leaf]:
    """Return the numeric fields."""
    return [leaf for leaf in leaves(message) if leaf.type.kind in "iuf"]


def _shifted(original: Values, by: float, leaf: Leaf) -> Values:
    if leaf.type.kind == "f":
        return (original + by).astype(leaf.type)
    return _clipped([value + round(by) for value in original.ravel().tolist()], leaf).reshape(original.shape)


def _times(original: Values, by: float, leaf: Leaf) -> Values:
    if leaf.type.kind == "f":
        return (original * by).astype(leaf.type)
    return _clipped([round(value * by) for value in original.ravel().tolist()], leaf).reshape(original.shape)


def _between(least: Values, greatest: Values, chance: NDArray[np.float64], leaf: Leaf) -> Values:
    if leaf.type.kind == "f":
        return (least + chance * (greatest - least)).astype(leaf.type)
    rows = zip(*(numbers.ravel().tolist() for numbers in (least, greatest, chance)), strict=True)
    drawn = [low + int(share * (high - low + 1)) for low, high, share in rows]
    return _clipped(drawn, leaf).reshape(least.shape)


def _clipped(values: list[int], leaf: Leaf) -> Values:
    """Clip whole numbers to a field's range."""
    lowest, highest = bounds(leaf.type, leaf.most)
    return np.array([min(max(value, lowest), highest) for value in values], dtype=leaf.type)
