"""Base classes of injected faults: activation interval, and affected cells or links."""

from __future__ import annotations

import json
import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any, ClassVar, Generic, Literal, Self, TypeVar, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, TypeAdapter, model_validator

from bus.lattice import NO_TICK_LIMIT, OPPOSITE, SIDES, Lattice
from bus.random_streams import rng
from bus.spec import CellName, Spec
from bus.wire.msgpack_codec import TICK_LIMIT

Index = NDArray[np.int64]
Problem = tuple[tuple[str | int, ...], object, str]
"""Path from the fault's table, value, and the rule that it breaks."""
Time = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]


def tick_at(at_s: float, tick_ns: int) -> int:
    """The first tick that does not begin before a scheduled time ``at_s`` (s, >= 0)."""
    return math.ceil(Fraction(repr(at_s)) * 1_000_000_000 / tick_ns)


class FaultSpec(Spec):
    """A fault of a scene: one of its ``[[faults]]``, discriminated by ``kind``.

    The fault is active from the first tick boundary not before ``at_s`` to the first not before ``until_s``, in
    simulated time.
    """

    kind_name: ClassVar[str]
    """Its ``kind``."""
    repairable: ClassVar[bool] = True
    """Whether the fault lasts and can be repaired; else it happens once."""

    at_s: Time = 0.0
    """Start of the fault, simulated time."""
    until_s: Time | None = None
    """Repair of the fault, simulated time; None: no repair."""

    @model_validator(mode="after")
    def _repaired_later(self) -> Self:
        if self.until_s is not None and not self.repairable:
            raise ValueError(f"{self.kind_name} happens once: leave until_s out")
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"until_s must be after at_s, {self.at_s:g}, not {self.until_s:g}")
        return self

    def tick_range(self, tick_at: Callable[[float], int]) -> tuple[int, int]:
        """First tick in which the fault acts, and first in which it no longer does.

        The second is ``bus.lattice.NO_TICK_LIMIT`` where the fault is never repaired.

        Args:
            tick_at: The tick in which something scheduled acts, by its time in seconds.
        """
        return tick_at(self.at_s), NO_TICK_LIMIT if self.until_s is None else tick_at(self.until_s)

    @abstractmethod
    def problems(self, lattice: Lattice) -> Iterator[Problem]:
        """Yield settings of the fault that do not fit the array."""

    @abstractmethod
    def affected_cells(self, lattice: Lattice, seed: int, number: int) -> Index:
        """Return the indices of affected cells, ascending.

        Args:
            lattice: Of the scene.
            seed: Of the scene.
            number: Of the fault in the scene, from 0.
        """


class CellTarget(FaultSpec):
    """A fault that affects cells: give one of ``cell``, ``cells``, ``rectangle`` and ``share``."""

    cell: CellName | None = None
    """One cell, ``[row, column]``."""
    cells: Annotated[tuple[CellName, ...], Field(min_length=1)] | None = None
    """Several cells."""
    rectangle: tuple[CellName, CellName] | None = None
    """Two corners, ``[[row, column], [row, column]]``: all existing cells of the rectangle between them."""
    share: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] | None = None
    """Share of all cells, rounded to a whole number of cells, drawn by the scene's seed. A greater share includes the
    cells of a smaller share."""

    @model_validator(mode="after")
    def _one_target(self) -> Self:
        given = [name for name, value in self._targets().items() if value is not None]
        if len(given) != 1:
            listed = ", ".join(given) or "none"
            raise ValueError(f"give one of {', '.join(self._targets())}, not {listed}")
        return self

    def _targets(self) -> dict[str, object]:
        return {
            "cell": self.cell,
            "cells": self.cells,
            "rectangle": self.rectangle,
            "share": self.share,
        }

    def _named(self) -> Iterator[tuple[tuple[str | int, ...], CellName]]:
        """Every cell that has to exist, and where it is named."""
        if self.cell is not None:
            yield ("cell",), self.cell
        for number, cell in enumerate(self.cells or ()):
            yield ("cells", number), cell

    def problems(self, lattice: Lattice) -> Iterator[Problem]:
        """Cells that don't exist."""
        for path, cell in self._named():
            if cell not in lattice:
                yield path, list(cell), _absent(cell, lattice)
        if self.rectangle is not None and not len(self._inside(self.rectangle, lattice)):
            yield (
                ("rectangle",),
                [list(corner) for corner in self.rectangle],
                "the array has no cell in there",
            )

    def affected_cells(self, lattice: Lattice, seed: int, number: int) -> Index:
        """Return the indices of affected cells, ascending; see `FaultSpec.affected_cells`."""
        if self.share is not None:
            order = rng(seed, f"faults.{number}.{self.kind_name}").permutation(len(lattice))
            return np.sort(order[: round(self.share * len(lattice))]).astype(np.int64)
        if self.rectangle is not None:
            return self._inside(self.rectangle, lattice)
        return np.unique(np.array([lattice.index(cell) for _, cell in self._named()], dtype=np.int64))

    @staticmethod
    def _inside(corners: tuple[CellName, CellName], lattice: Lattice) -> Index:
        (r0, c0), (r1, c1) = corners
        rows, columns = lattice.rows, lattice.columns
        within = (rows >= min(r0, r1)) & (rows <= max(r0, r1))
        within &= (columns >= min(c0, c1)) & (columns <= max(c0, c1))
        return np.flatnonzero(within)


class LinkTarget(CellTarget):
    """A fault that affects links of cells: links on ``side``, or on every side."""

    side: Literal["north", "east", "south", "west"] | None = None
    """Side of each affected cell; None: all four sides."""
    direction: Literal["both", "out", "in"] = "both"
    """Messages that the cells send (``out``), messages that the cells receive (``in``), or both."""

    def problems(self, lattice: Lattice) -> Iterator[Problem]:
        """Yield cells that don't exist, and a side on which the cell has no neighbour."""
        found = list(super().problems(lattice))
        yield from found
        if found or self.side is None or self.cell is None:
            return
        if lattice.neighbours[lattice.index(self.cell), SIDES.index(self.side)] < 0:
            row, column = self.cell
            yield ("side",), self.side, f"cell {row},{column} has no neighbour there"

    def affected_links(self, lattice: Lattice, seed: int, number: int) -> Index:
        """Return the affected links, ``(m, 2)``: index of the receiving cell and side; ascending, each once."""
        cells = self.affected_cells(lattice, seed, number)
        sides = range(len(SIDES)) if self.side is None else (SIDES.index(self.side),)
        return links_of(
            lattice, cells, sides, incoming=self.direction != "out", outgoing=self.direction != "in"
        )


def links_of(
    lattice: Lattice,
    cells: Index,
    sides: Iterable[int] = range(len(SIDES)),
    *,
    incoming: bool,
    outgoing: bool,
) -> Index:
    """Return links by receiver, ``(m, 2)``: cell and side, ascending, each once.

    Args:
        lattice: The cells.
        cells: Cells whose links are selected.
        sides: Sides of these cells.
        incoming: Include links on which the cells receive.
        outgoing: Include links on which the cells send.
    """
    links: set[tuple[int, int]] = set()
    for cell in cells.tolist():
        for side in sides:
            other = int(lattice.neighbours[cell, side])
            if other < 0:
                continue
            if incoming:
                links.add((cell, side))
            if outgoing:
                links.add((other, OPPOSITE[side]))
    return np.array(sorted(links), dtype=np.int64).reshape(-1, 2)


_Fault_co = TypeVar("_Fault_co", bound=FaultSpec, covariant=True)


@final
@dataclass(slots=True, eq=False)
class FaultInstance(Generic[_Fault_co]):
    """A fault of a run, its times in ticks.

    Attributes:
        number: Index among the faults of the run, from 0; part of the name of the fault's random stream.
        fault: Specification of the fault.
        cells: Indices of affected cells, ascending.
        start_tick: First tick in which the fault is active.
        end_tick: First tick in which the fault is no longer active; ``bus.lattice.NO_TICK_LIMIT`` if it is never
            repaired. A repair at run time changes the value.
        injected_at_runtime: Whether the fault was injected while the run was in progress.
    """

    number: int
    fault: _Fault_co
    cells: Index
    start_tick: int
    end_tick: int = NO_TICK_LIMIT
    injected_at_runtime: bool = False

    def active_at(self, tick: int) -> bool:
        """Whether it acts in a tick."""
        return self.start_tick <= tick < self.end_tick

    def record(self) -> dict[str, Any]:
        """Return the fault, injected at run time, in JSON's types; ``decode_fault`` is the inverse."""
        fault = self.fault.model_dump(mode="json", exclude_none=True, exclude={"at_s", "until_s"})
        end = None if self.end_tick == NO_TICK_LIMIT else self.end_tick
        return {"number": self.number, "fault": fault, "first": self.start_tick, "end": end}


_Whole = Annotated[int, Field(ge=0, lt=TICK_LIMIT)]


class _FaultRecord(Spec):
    """Content of a record that begins a fault."""

    number: _Whole
    fault: dict[str, JsonValue]
    first: _Whole
    end: _Whole | None


class RepairRecord(Spec):
    """Content of a record that ends a fault."""

    number: _Whole
    end: _Whole


def build_validators(kinds: TypeAdapter[Any]) -> None:
    """Build the validators of records of faults and repairs, which are else built for the first one.

    Args:
        kinds: Kinds of faults that they may have.
    """
    kinds.rebuild()
    for record in (_FaultRecord, RepairRecord):
        record.model_rebuild()


def decode_fault(
    data: object, kinds: TypeAdapter[Any], lattice: Lattice, seed: int
) -> FaultInstance[FaultSpec]:
    """Decode a fault that ``FaultInstance.record`` has encoded; in the same scene it affects the same cells.

    Args:
        data: The record.
        kinds: Kinds of faults that it may be.
        lattice: Of the scene.
        seed: Of the scene.

    Raises:
        ValueError: The data are no such fault, or name cells outside the array.
    """
    one = _FaultRecord.model_validate_json(json.dumps(data, default=str), strict=True)
    fault: FaultSpec = kinds.validate_json(json.dumps(one.fault), strict=True)
    if any(True for _ in fault.problems(lattice)):
        raise ValueError("it names cells that are not in the array")
    end = NO_TICK_LIMIT if one.end is None else one.end
    affected = fault.affected_cells(lattice, seed, one.number)
    return FaultInstance(one.number, fault, affected, one.first, end, injected_at_runtime=True)


def transition_ticks(faults: Sequence[FaultInstance[FaultSpec]]) -> list[int]:
    """Return the ticks in which a fault begins or ends, ascending."""
    return sorted(
        {tick for one in faults for tick in (one.start_tick, one.end_tick) if tick != NO_TICK_LIMIT}
    )


def _absent(cell: CellName, lattice: Lattice) -> str:
    """Describe why the array has no such cell."""
    rows, columns = int(lattice.rows.max()), int(lattice.columns.max())
    if cell[0] > rows:
        return f"the array has rows 0..{rows}"
    if cell[1] > columns:
        return f"the array has columns 0..{columns}"
    return "the array has no cell there"
