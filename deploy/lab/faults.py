"""Faults of a lab: validated as those of a scene, and written as a scene that ``mdms run`` repeats."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import NO_TICK_LIMIT, Lattice
from cell_firmware.errors import dotted
from cell_firmware.faults.base import CellFault
from cell_firmware.loader import check_importable
from deploy.errors import InputError
from deploy.faults.crash import CrashFault
from deploy.faults.registry import KINDS, Fault
from deploy.scenes.errors import problems_of, strictly_any
from deploy.util.files import write_text
from deploy.util.toml import toml_text
from plant.faults.base import PlantFault

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

Table = dict[str, Any]
Covered = Sequence[tuple[int, NDArray[np.bool_]]]
"""Changes of presence bits, ``(n, sensors)``, by the tick in which they are read first."""

_TICK_KEYS: Final = {"at_tick": "at_s", "until_tick": "until_s"}
_KINDS: Final[TypeAdapter[Any]] = TypeAdapter(Fault)


def seconds(tick: int, tick_ns: int) -> float:
    """Return the start of a tick as the decimal number of seconds that ``FaultSpec.at_s`` takes."""
    return float(Decimal(tick * tick_ns) / 10**9)


def in_seconds(fault: Mapping[str, Any], tick_ns: int) -> Table:
    """Return a fault's table with times in seconds in place of ``at_tick`` and ``until_tick``."""
    return {
        _TICK_KEYS.get(key, key): seconds(value, tick_ns) if key in _TICK_KEYS else value
        for key, value in fault.items()
    }


def checked_fault(table: Mapping[str, Any], scene: Scene) -> FaultSpec:
    """Validate a fault of the scene's cells.

    Raises:
        InputError: It is refused; names the keys and the rules.
    """
    kind = table["kind"]
    try:
        fault = cast("FaultSpec", strictly_any(_KINDS, dict(table)))
    except ValidationError as error:
        found = problems_of(error, dict(table), KINDS.get(kind, CrashFault))
        raise InputError("\n".join(f"fault {kind}: {one}" for one in found)) from None
    problems = list(fault.problems(scene.lattice()))
    if isinstance(fault, CellFault):
        problems += fault.fit_problems(scene.cells, len(scene.array.sensors_m))
    if isinstance(fault, PlantFault):
        problems += fault.setting_problems(scene.effects)
    if problems:
        raise InputError(
            "\n".join(f"fault {kind}: {dotted(path)} = {value}: {rule}" for path, value, rule in problems)
        )
    return fault


def fault_tables(
    scene: Scene, injected: Iterable[FaultInstance[FaultSpec]], covered: Covered, lattice: Lattice, tick: int
) -> list[Table]:
    """Return the tables of a scene's ``[[faults]]`` that repeat a lab.

    Args:
        scene: Scene of the lab.
        injected: Faults injected since.
        covered: Changes of the presence bits.
        lattice: All cells.
        tick: The next tick of the lab.
    """
    tables = [one.model_dump(mode="json", exclude_none=True) for one in scene.faults]
    for one in injected:
        table = one.fault.model_dump(mode="json", exclude_none=True, exclude={"at_s", "until_s"})
        times: Table = {"at_s": seconds(one.start_tick, scene.tick_ns)}
        if one.fault.repairable and one.end_tick != NO_TICK_LIMIT:
            if (
                one.end_tick <= one.start_tick
            ):  # repaired before it began; its number belongs to its random stream
                times["until_s"], times["at_s"] = (
                    seconds(tick + 2, scene.tick_ns),
                    seconds(tick + 1, scene.tick_ns),
                )
            else:
                times["until_s"] = seconds(one.end_tick, scene.tick_ns)
        tables.append({"kind": table.pop("kind"), **times, **table})
    return tables + presence_tables(covered, lattice, scene.tick_ns)


def presence_tables(covered: Covered, lattice: Lattice, tick_ns: int) -> list[Table]:
    """Return faults ``sensor_stuck`` that have cells without parcels read these presence bits."""
    spans: defaultdict[tuple[int, int, int], list[list[int]]] = defaultdict(list)
    begun: dict[tuple[int, int], int] = {}
    for tick, bits in (*covered, (NO_TICK_LIMIT, None)):
        on: set[tuple[int, int]] = set()
        if bits is not None:
            on.update((int(i), int(s)) for i, s in np.argwhere(bits))
        for cell, sensor in sorted(set(begun) - on):
            start = begun.pop((cell, sensor))
            if start < tick:
                spans[start, tick, sensor].append(list(lattice.cells[cell]))
        for place in on - set(begun):
            begun[place] = tick
    return [
        {
            "kind": "sensor_stuck",
            "at_s": seconds(start, tick_ns),
            **({} if end == NO_TICK_LIMIT else {"until_s": seconds(end, tick_ns)}),
            "cells": cells,
            "sensor": sensor,
            "value": 1,
        }
        for (start, end, sensor), cells in sorted(spans.items())
    ]


def scene_tables(scene: Scene, faults: Sequence[Table], ticks: int, title: str = "") -> Table:
    """Return the tables of a scene that runs so many ticks with these faults."""
    tables = scene.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    tables |= {"duration_s": seconds(max(ticks, 1), scene.tick_ns), "faults": list(faults)}
    if title:
        tables["title"] = title
    cells = tables.get("cells", {})
    if not cells.get("initial_registers", True):
        del cells["initial_registers"]
    return {name: tables[name] for name in sorted(tables, key=_order)}


def write_scene(path: Path, scene: Scene, faults: Sequence[Table], ticks: int, title: str = "") -> None:
    """Write the scene of ``scene_tables`` to a file.

    Raises:
        FirmwareError: The firmware is an object that another process can't import.
        DeployError: The file can't be written.
    """
    check_importable(scene.cells.firmware)
    tables = scene_tables(scene, faults, ticks, title)
    file, colon, name = scene.cells.firmware.partition(":")
    if file.endswith(".py"):  # a relative path starts at the scene's folder
        tables["cells"]["firmware"] = os.path.relpath(file, path.absolute().parent) + colon + name
    write_text(path, toml_text(tables))


def _order(name: str) -> tuple[int, str]:
    first = ("title", "duration_s", "seed", "array", "cells")
    return (first.index(name) if name in first else len(first) + (name == "faults"), name)
