"""Key expressions of a run, and how they match.

Every key begins with ``mdms/RUN``. ``docs/bus.md`` lists them all.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal

from bus.errors import RunNameError
from bus.lattice import SIDES

if TYPE_CHECKING:
    from bus.partition import Partition

RunLeaf = Literal["sense", "drive", "alive", "ready"]
WireFormat = Literal["packed", "per_cell", "relayed"]
"""Name of a wire format; ``bus.wire.formats`` has the formats."""

_RUN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,63}")


def check_run(run: str) -> str:
    """The name of a run, if it can stand in a key expression.

    Raises:
        RunNameError: Not 1 to 64 letters, digits, ``_``, ``.`` or ``-``, beginning with a letter or digit.
    """
    if _RUN.fullmatch(run) is None:
        raise RunNameError(
            f"run name {run!r}: must be 1 to 64 of A-Z a-z 0-9 _ . -, beginning with a letter or a digit"
        )
    return run


def cell_key(run: str, cell: tuple[int, int] | None, leaf: RunLeaf) -> str:
    """Key of one cell, or of every cell for None."""
    row, column = ("*", "*") if cell is None else cell
    return f"mdms/{run}/cell/{row}/{column}/{leaf}"


def cell_link_key(run: str, cell: tuple[int, int], side: int) -> str:
    """Key of what ``cell`` sends towards ``side`` (an index into ``SIDES``)."""
    return f"mdms/{run}/cell/{cell[0]}/{cell[1]}/to/{SIDES[side]}"


def shard_key(
    run: str, shard: int | None, leaf: RunLeaf | Literal["report", "registers", "snapshot", "join"]
) -> str:
    """Key of one shard, or of every shard for None."""
    return f"mdms/{run}/shard/{'*' if shard is None else shard}/{leaf}"


def shard_process_key(run: str, shard: int | None, process: str) -> str:
    """Key of the token of a process that was started by hand for a shard; ``process``: its own name, or ``*``."""
    return f"mdms/{run}/shard/{'*' if shard is None else shard}/process/{process}"


def shard_link_key(run: str, source: int, target: int) -> str:
    """Key of what shard ``source`` sends to shard ``target``."""
    return f"mdms/{run}/shard/{source}/to/{target}"


def plant_key(run: str, leaf: Literal["view", "control", "alive", "operator", "status"]) -> str:
    """Key of the plant."""
    return f"mdms/{run}/plant/{leaf}"


def message_kinds(run: str, form: WireFormat, units: int) -> dict[str, int]:
    """Key expression of each kind of message of a run, and how many of that kind a tick has at most.

    Args:
        run: Name of the run.
        form: The wire format.
        units: Number of cells in the format ``per_cell``, of shards in the others.

    Returns:
        In the order in which a tick's messages are sent.
    """
    prefix = f"mdms/{run}"
    unit = f"{prefix}/cell/*/*" if form == "per_cell" else f"{prefix}/shard/*"
    links = {} if form == "relayed" else {f"{unit}/to/*": units * len(SIDES)}
    return {
        f"{prefix}/plant/control": units,
        f"{unit}/sense": units,
        **links,
        **{f"{prefix}/shard/*/{leaf}": units for leaf in ("snapshot", "registers", "report")},
        f"{unit}/drive": units,
    }


def owner_of(key: str, partition: Partition) -> str:
    """Describe the owner of a key of a run: ``cell 3,4``, ``shard 2`` or ``plant``.

    A shard of one cell is described as that cell.
    """
    match key.split("/")[2:]:
        case ["cell", row, column, *_]:
            return f"cell {row},{column}"
        case ["shard", shard, *_]:
            cells = partition.cells(int(shard))
            if len(cells) > 1:
                return f"shard {shard}"
            row, column = partition.lattice.cells[int(cells[0])]
            return f"cell {row},{column}"
        case _:
            return "plant"


def intersects(a: str, b: str) -> bool:
    """Whether two key expressions have a key in common; ``*`` is one chunk, ``**`` any number of them."""
    return _intersects(a.split("/"), b.split("/"))


def _intersects(a: list[str], b: list[str]) -> bool:
    while a and b:
        if a[0] == "**":
            return _intersects(a[1:], b) or _intersects(a, b[1:])
        if b[0] == "**":
            return _intersects(a, b[1:]) or _intersects(a[1:], b)
        if a[0] != b[0] and "*" not in (a[0], b[0]):
            return False
        a, b = a[1:], b[1:]
    return all(chunk == "**" for chunk in a) and all(chunk == "**" for chunk in b)
