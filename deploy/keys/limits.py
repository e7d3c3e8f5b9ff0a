"""How large what comes in may be, as Zenoh reads it: what a role may put is bounded in size, too.

Payloads wait for their reader up to 65,536 at a time, whatever their size. Decoders refuse what is too long, but only
once it has been read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from bus.keeping import CELL_LIMIT
from bus.keys import cell_key, plant_key, shard_key
from bus.wire import TALLY_LIMIT, TEXT_LIMIT

if TYPE_CHECKING:
    from deploy.keys.roles import Cut

_ENVELOPE: Final = 1 << 10
"""Bytes for what every payload has: names, tick, version."""
_MESSAGE: Final = 1 << 13
"""Bytes for the message of one link: twice what a firmware may declare, with the names of its fields."""
_REGISTERS: Final = 1 << 14
"""Bytes for the registers of one cell."""
_QUESTION: Final = 1 << 17


def size_limits(cut: Cut) -> list[dict[str, Any]]:
    """Zenoh's ``low_pass_filter`` of the session that cells join.

    Messages that are longer are dropped as they come in, and counted as denied.
    """
    shards = range(cut.partition.count)
    cells = max(len(cut.partition.cells(shard)) for shard in shards)
    links = max(len(cut.partition.outgoing(shard)) for shard in shards)
    report = 4 * TEXT_LIMIT + TALLY_LIMIT * (4 * TALLY_LIMIT + 16) + 16 * cells
    link_keys = ["mdms/*/cell/*/*/to/*", "mdms/*/shard/*/to/*"]
    return [
        _limit(
            "drive", [cell_key("*", None, "drive"), shard_key("*", None, "drive")], _ENVELOPE + 16 * cells
        ),
        _limit("link", link_keys, _ENVELOPE + _MESSAGE * max(links, 1)),
        _limit("report", [shard_key("*", None, "report")], _ENVELOPE + report),
        _limit("registers", [shard_key("*", None, "registers")], _ENVELOPE + _REGISTERS * cells),
        _limit("memory", [shard_key("*", None, "memory")], _ENVELOPE + CELL_LIMIT * (cells + 1)),
    ]


def _limit(name: str, keys: list[str], size: int, message: str = "put") -> dict[str, Any]:
    return {"id": name, "flows": ["ingress"], "messages": [message], "key_exprs": keys, "size_limit": size}


QUESTION_LIMITS: Final = [_limit("question", [plant_key("*", "operator")], _QUESTION, "query")]
"""Zenoh's ``low_pass_filter`` of the session for listeners and operators."""
