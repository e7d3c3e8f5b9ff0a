"""Faults that begin and end, as recordings, summaries and pictures have them, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from deploy.words import counted

if TYPE_CHECKING:
    from bus.fault import FaultSpec, Injected

_DID = {"crash": "crashed", "token_lost": "went away"}
"""What a cell did that is lost, by the fault's kind, where that is not the word for it."""
OUT = ("remove", "add")
"""Kinds of which cells are not in the array while they act."""


def turned(
    one: Injected[FaultSpec], tick: int, period_ns: int, names: Sequence[tuple[int, int]]
) -> dict[str, Any]:
    """A fault that begins or ends in a tick, as ``faults`` of a summary and ``/faults`` of a recording have it.

    Args:
        one: Of the run.
        tick: Its first, or its end.
        period_ns: Of a tick.
        names: ``(row, column)`` of every cell.
    """
    cells = [list(names[int(cell)]) for cell in one.cells]
    phase = ("begins" if one.fault.lasts else "happens") if tick == one.first else "ends"
    return {
        "time_s": tick * period_ns * 1e-9,
        "kind": one.fault.called,
        "phase": phase,
        "cell": cells[0] if len(cells) == 1 else None,
        "cells": cells,
        "tick": tick,
        "detail": "live" if one.live else "scheduled",
        "fault": one.fault.model_dump(mode="json", exclude_none=True),
        "number": one.number,
    }


def lines(faults: Sequence[Mapping[str, Any]]) -> list[str]:
    """A run's faults, each in a line: ``crash of 3 cells at 1.2 s, repaired at 2 s``; ``3,4 crashed at 2.00294 s``."""
    ends = {fault["number"]: fault["time_s"] for fault in faults if fault.get("phase") == "ends"}
    return [
        _lasting(fault, ends.get(fault["number"])) if "phase" in fault else _lost(fault)
        for fault in faults
        if fault.get("phase") != "ends"
    ]


def marks(faults: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """When faults begin or end, and a few words, as a picture's marks have them."""
    return [
        (float(fault["time_s"]), _mark(fault))
        for fault in faults
        if "phase" in fault and (fault["kind"] != "add" or fault["phase"] == "ends")
    ]


def out_of_array(faults: Sequence[Mapping[str, Any]]) -> dict[tuple[int, int], float | None]:
    """Each cell that was out of the array, and when it came back or came; None: it isn't there at the end."""
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


def _lost(fault: Mapping[str, Any]) -> str:
    """A cell that died, for good."""
    row, column = fault["cell"]
    return f"{row},{column} {_DID.get(fault['kind'], fault['kind'])} at {fault['time_s']:g} s"


def _mark(fault: Mapping[str, Any]) -> str:
    """``cell 3,4 plugged in``; ``3 cells: wheel stuck ends``."""
    if fault["kind"] in OUT:
        return f"{_cells(fault, 'cell ')} {'plugged in' if fault['phase'] == 'ends' else 'pulled'}"
    return f"{_cells(fault, 'cell ')}: {_kind(fault)}{' ends' if fault['phase'] == 'ends' else ''}"


def _cells(fault: Mapping[str, Any], one: str = "") -> str:
    """Which cell, or how many."""
    cells = fault["cells"]
    return f"{one}{cells[0][0]},{cells[0][1]}" if len(cells) == 1 else counted(len(cells), "cell")


def _kind(fault: Mapping[str, Any]) -> str:
    return fault["kind"].replace("_", " ")


def _lasting(fault: Mapping[str, Any], end_s: float | None) -> str:
    """One that begins, and may end."""
    struck = _cells(fault)
    if fault["kind"] == "add":
        return f"{struck} not there yet" if end_s is None else f"{struck} plugged in at {end_s:g} s"
    if fault["kind"] == "remove":
        again = "" if end_s is None else f", plugged in again at {end_s:g} s"
        return f"{struck} pulled at {fault['time_s']:g} s{again}"
    repaired = "" if end_s is None else f", repaired at {end_s:g} s"
    return f"{_kind(fault)} of {struck} at {fault['time_s']:g} s{repaired}"
