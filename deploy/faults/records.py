"""Records of fault transitions for recordings, summaries and plots, and their descriptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from deploy.util.formatting import plural

if TYPE_CHECKING:
    from bus.fault import FaultInstance, FaultSpec

_DID = {"crash": "crashed", "timed_out": "timed out"}
"""Verb for the loss of a cell, by kind of the fault; other kinds are their own verb."""
_BACK = "respawn"
"""Kind of records of lost cells that rejoined."""
OUT = ("remove", "add")
"""Kinds of faults whose cells are absent from the array while the fault is active."""


def transition_records(
    one: FaultInstance[FaultSpec], tick: int, period_ns: int, names: Sequence[tuple[int, int]]
) -> list[dict[str, Any]]:
    """Return the transitions of a fault in a tick, as ``faults`` of a summary and ``/faults`` of a recording have them.

    Both do if a live fault is repaired in the tick in which it begins.

    Args:
        one: Of the run.
        tick: The tick.
        period_ns: Of a tick.
        names: ``(row, column)`` of every cell.
    """
    cells = [list(names[int(cell)]) for cell in one.cells]
    phases = ["begins" if one.fault.repairable else "happens"] if tick == one.start_tick else []
    if tick == one.end_tick:
        phases.append("ends")
    return [
        {
            "time_s": tick * period_ns * 1e-9,
            "kind": one.fault.kind_name,
            "phase": phase,
            "cell": cells[0] if len(cells) == 1 else None,
            "cells": cells,
            "tick": tick,
            "detail": "live" if one.injected_at_runtime else "scheduled",
            "fault": one.fault.model_dump(mode="json", exclude_none=True),
            "number": one.number,
        }
        for phase in phases
    ]


def describe_faults(faults: Sequence[Mapping[str, Any]]) -> list[str]:
    """A run's faults, each in a line: ``crash of 3 cells at 1.2 s, repaired at 2 s``; ``3,4 crashed at 2.00294 s``.

    Cells that were lost together share one.
    """
    ends = {fault["number"]: fault["time_s"] for fault in faults if fault.get("phase") == "ends"}
    return [
        _lost(alike) if "phase" not in alike[0] else _lasting(alike[0], ends.get(alike[0].get("number")))
        for alike in _together(faults)
        if alike[0].get("phase") != "ends"
    ]


def plot_marks(faults: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """Return times and labels of plot marks: faults begin or end, cells are lost or rejoin."""
    return [
        (
            float(alike[0]["time_s"]),
            _mark(alike[0]) if "phase" in alike[0] else f"{_cells_of(alike, 'cell ')} lost",
        )
        for alike in _together(faults)
        if alike[0]["kind"] != "add" or alike[0]["phase"] == "ends"
    ]


def lost_for_good(faults: Sequence[Mapping[str, Any]]) -> dict[tuple[int, int], float]:
    """Return each cell that was lost and did not rejoin, and the time of its loss."""
    lost: dict[tuple[int, int], float] = {}
    for fault in faults:
        if fault["kind"] == _BACK:
            for row, column in fault["cells"]:
                lost.pop((row, column), None)
        elif "phase" not in fault:
            row, column = fault["cell"]
            lost.setdefault((row, column), float(fault["time_s"]))
    return lost


def out_of_array(faults: Sequence[Mapping[str, Any]]) -> dict[tuple[int, int], float | None]:
    """Return each cell that was out of the array and the time of its return; None: absent at the end."""
    out: dict[tuple[int, int], float | None] = {}
    away: dict[tuple[int, int], int] = {}
    for fault in faults:
        if fault["kind"] not in OUT:
            continue
        for row, column in fault["cells"]:
            cell = (row, column)
            away[cell] = away.get(cell, 0) + (1 if fault["phase"] == "begins" else -1)
            out[cell] = None if away[cell] else float(fault["time_s"])
    return out


def _together(faults: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Group records of cells lost at the same time; every other record is a group by itself."""
    found: dict[object, list[Mapping[str, Any]]] = {}
    for place, fault in enumerate(faults):
        found.setdefault(place if "phase" in fault else (fault["kind"], fault["time_s"]), []).append(fault)
    return list(found.values())


def _cells_of(lost: Sequence[Mapping[str, Any]], one: str = "") -> str:
    """Which cell was lost, or how many."""
    row, column = lost[0]["cell"]
    return f"{one}{row},{column}" if len(lost) == 1 else plural(len(lost), "cell")


def _lost(alike: Sequence[Mapping[str, Any]]) -> str:
    """Cells that died."""
    kind, time_s = alike[0]["kind"], alike[0]["time_s"]
    return f"{_cells_of(alike)} {_DID.get(kind, kind)} at {time_s:g} s"


def _mark(fault: Mapping[str, Any]) -> str:
    """``cell 3,4 plugged in``; ``3 cells: wheel stuck ends``."""
    if fault["kind"] in OUT:
        return f"{_cells(fault, 'cell ')} {'plugged in' if fault['phase'] == 'ends' else 'pulled'}"
    if fault["kind"] == _BACK:
        return f"{_cells(fault, 'cell ')} rejoined"
    return f"{_cells(fault, 'cell ')}: {_kind(fault)}{' ends' if fault['phase'] == 'ends' else ''}"


def _cells(fault: Mapping[str, Any], one: str = "") -> str:
    """Which cell, or how many."""
    cells = fault["cells"]
    return f"{one}{cells[0][0]},{cells[0][1]}" if len(cells) == 1 else plural(len(cells), "cell")


def _kind(fault: Mapping[str, Any]) -> str:
    return fault["kind"].replace("_", " ")


def _lasting(fault: Mapping[str, Any], end_s: float | None) -> str:
    """One that begins, and may end."""
    affected = _cells(fault)
    if fault["kind"] == _BACK:
        return f"{affected} rejoined at {fault['time_s']:g} s"
    if fault["kind"] == "add":
        return f"{affected} not plugged in" if end_s is None else f"{affected} plugged in at {end_s:g} s"
    if fault["kind"] == "remove":
        again = "" if end_s is None else f", plugged in again at {end_s:g} s"
        return f"{affected} pulled at {fault['time_s']:g} s{again}"
    repaired = "" if end_s is None else f", repaired at {end_s:g} s"
    return f"{_kind(fault)} of {affected} at {fault['time_s']:g} s{repaired}"
