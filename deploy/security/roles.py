"""Roles of a run, and the rights of each role on the bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

from bus.wire.keys import (
    WireFormat,
    cell_key,
    cell_link_key,
    plant_key,
    shard_key,
    shard_link_key,
    shard_process_key,
)

if TYPE_CHECKING:
    from bus.partition import Partition

PLANT: Final = "plant"
OPERATOR: Final = "operator"
ROUTER: Final = "router"
"""Name of a router's credentials, which are a server's and give no rights."""

_ANY: Final = "*"
"""Run part of a key: rights apply to any run, since a run's name is drawn at its start."""


@final
@dataclass(frozen=True, slots=True)
class Role:
    """Rights of a role on the bus; everything else is denied.

    Attributes:
        name: Common name of the certificate, or user name.
        cells: ``(row, column)`` of the cells whose process has the role.
        puts: Keys to put on.
        hears: Keys to subscribe to.
        shows: Keys of liveliness tokens to show.
        watches: Keys of liveliness tokens to watch.
        asks: Keys to query.
        answers: Keys whose queries it answers.
    """

    name: str
    cells: tuple[tuple[int, int], ...] = ()
    puts: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    shows: tuple[str, ...] = ()
    watches: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()


PLANT_AT_ROUTER: Final = Role(
    PLANT,
    puts=("mdms/**",),
    hears=("mdms/**",),
    shows=(plant_key(_ANY, "alive"),),
    watches=("mdms/**",),
    answers=("mdms/**",),
)
"""Role of a plant that connects to a router; its own sessions are not checked."""
OPERATORS: Final = Role(
    OPERATOR,
    hears=("mdms/**",),
    watches=("mdms/**",),
    asks=(plant_key(_ANY, "operator"), plant_key(_ANY, "view"), plant_key(_ANY, "status")),
)
"""Role that listens to a run from outside and sends requests."""


@final
@dataclass(frozen=True, slots=True)
class ProcessLayout:
    """Layout of a run's cells in processes.

    Attributes:
        partition: The cells of each process.
        wire: Wire format.
        names: Name of each process, ``cells 3`` or ``cell 3,4``.
    """

    partition: Partition
    wire: WireFormat
    names: tuple[str, ...]

    def role(self, shard: int) -> str:
        """Return the name of a process's role: ``cells-3``, or ``cell-3-4`` where each cell has a process."""
        return self.names[shard].replace(" ", "-").replace(",", "-")

    def cells(self, shard: int) -> tuple[tuple[int, int], ...]:
        """Return ``(row, column)`` of a process's cells."""
        cells = self.partition.lattice.cells
        return tuple(cells[int(i)] for i in self.partition.cells(shard))


def roles_of(cut: ProcessLayout) -> tuple[Role, ...]:
    """Return all roles: the plant, then one for each process of cells by shard, then operators.

    The plant's role has no rights, since the plant's own sessions control access and are not checked.
    """
    cells = (_cells(cut, shard) for shard in range(cut.partition.count))
    return Role(PLANT), *cells, OPERATORS


def _cells(cut: ProcessLayout, shard: int) -> Role:
    puts, hears, shows = _KEYS[cut.wire](cut, shard)
    return Role(
        cut.role(shard),
        cut.cells(shard),
        puts=(*puts, *(shard_key(_ANY, shard, leaf) for leaf in ("report", "registers", "snapshot"))),
        hears=(*hears, plant_key(_ANY, "control")),
        shows=(*shows, shard_process_key(_ANY, shard, _ANY)),
        watches=(plant_key(_ANY, "alive"),),
        asks=(shard_key(_ANY, shard, "join"),),
    )


_Keys = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]


def _relayed(cut: ProcessLayout, shard: int) -> _Keys:  # noqa: ARG001 - as every wire format
    """Return the keys that a shard puts, receives and shows in wire format ``relayed``."""
    shows = shard_key(_ANY, shard, "alive"), shard_key(_ANY, shard, "ready")
    return (shard_key(_ANY, shard, "drive"),), (shard_key(_ANY, shard, "sense"),), shows


def _packed(cut: ProcessLayout, shard: int) -> _Keys:
    """Return the keys that a shard puts, receives and shows in wire format ``packed``."""
    puts, hears, shows = _relayed(cut, shard)
    outgoing, incoming = cut.partition.outgoing_borders(shard), cut.partition.incoming_borders(shard)
    to = (shard_link_key(_ANY, shard, border.shard) for border in outgoing)
    fro = (shard_link_key(_ANY, border.shard, shard) for border in incoming)
    return (*puts, *to), (*hears, *fro), shows


def _by_cell(cut: ProcessLayout, shard: int) -> _Keys:
    """Return the keys that a shard puts, receives and shows in wire format ``per_cell``."""
    partition, own = cut.partition, cut.cells(shard)
    cells = partition.lattice.cells
    outgoing, incoming = partition.outgoing(shard), partition.incoming(shard)
    puts = [cell_key(_ANY, cell, "drive") for cell in own]
    puts += [
        cell_link_key(_ANY, cells[int(source)], int(side))
        for source, side in zip(outgoing.source, outgoing.source_side, strict=True)
    ]
    hears = [cell_key(_ANY, cell, "sense") for cell in own]
    hears += [
        cell_link_key(_ANY, cells[int(source)], int(side))
        for source, side in zip(incoming.source, incoming.source_side, strict=True)
    ]
    shows = [cell_key(_ANY, cell, leaf) for cell in own for leaf in ("alive", "ready")]
    return tuple(puts), tuple(hears), tuple(shows)


_KEYS: Final[dict[WireFormat, Callable[[ProcessLayout, int], _Keys]]] = {
    "packed": _packed,
    "per_cell": _by_cell,
    "relayed": _relayed,
}
