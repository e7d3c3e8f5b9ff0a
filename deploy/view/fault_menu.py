"""Menu of faults: every kind that can be injected at run time, with settings that make it act."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

_SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "wheel_weak": {"strength": 0.3},
    "lie": {"mode": "random"},
    "link_bandwidth": {"messages_per_s": 20.0},
    "link_corrupt": {"probability": 0.2},
    "link_delay": {"ticks": 20},
    "link_duplicate": {"probability": 0.5},
    "link_loss": {"probability": 0.5},
    "link_reorder": {"probability": 0.5},
    "sensor_delay": {"ticks": 50},
    "sensor_flip": {"rate": 0.1},
    "sensor_stuck": {"value": 1},
    "slow_clock": {"factor": 0.5},
}
"""Settings of kinds that need some, unless the page's user gives others."""
_IDEAL_SETTINGS: Final[dict[str, dict[str, Any]]] = {"wheel_runaway": {"speed_m_s": 0.5}}
"""Further settings without motors: a wheel that runs away has no supply that sets its speed."""
_GROUPS: Final = {"wheel": "Wheels", "sensor": "Sensors", "link": "Links", "partition": "Links"}
_MESSAGES: Final = frozenset(("babble", "lie"))


@cache
def fault_menu(*, motors: bool) -> tuple[dict[str, Any], ...]:
    """Return kind, group, description and settings of every kind, in the registry's order.

    Args:
        motors: Whether the scene has motors.
    """
    from deploy.faults.registry import KINDS, gist

    return tuple(
        {"kind": kind, "group": _group(kind), "gist": gist(kind), "settings": _settings(kind, motors=motors)}
        for kind in KINDS
        if kind != "add"  # for scenes alone: a removed cell is plugged in again by a repair
    )


def _group(kind: str) -> str:
    if kind in _MESSAGES:
        return "Links"
    return _GROUPS.get(kind.partition("_")[0], "Cell")


def _settings(kind: str, *, motors: bool) -> dict[str, Any]:
    return {**_SETTINGS.get(kind, {}), **({} if motors else _IDEAL_SETTINGS.get(kind, {}))}


def fault_request(
    kind: str, row: int, column: int, settings: dict[str, Any] | None = None, *, motors: bool
) -> dict[str, Any]:
    """Return the request for a fault of one cell.

    Args:
        kind: Kind of the fault.
        row: Row of the cell.
        column: Column of the cell.
        settings: Further keys of the fault, in place of the menu's.
        motors: Whether the scene has motors.
    """
    own = _settings(kind, motors=motors)
    target: dict[str, Any] = {"row": row} if kind == "partition" else {"cell": [row, column]}
    return {"op": "inject", "fault": {"kind": kind, **target, **own, **(settings or {})}}
