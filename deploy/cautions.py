"""Cautions before a run: of its scene's values, its boards and its firmware."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deploy.scene_cautions import scene_cautions

if TYPE_CHECKING:
    from cell_firmware.firmware import Cells
    from deploy.scene import Scene


def cautions_of(scene: Scene) -> tuple[str, ...]:
    """Return a line for each thing that looks mistaken, or will go wrong, though nothing forbids it.

    Raises:
        FirmwareError: The firmware raised when it was asked; with its traceback.
    """
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    of_firmware = tuple(firmware.cautions(scene.lattice()))
    return (*scene_cautions(scene), *of_firmware, *_processor(scene, talks=firmware.message is not None))


def tell_cautions(scene: Scene, tell: Callable[[str], None]) -> tuple[str, ...]:
    """Tell each caution of a scene in a line; returns them.

    Raises:
        FirmwareError: The firmware raised when it was asked; with its traceback.
    """
    cautions = cautions_of(scene)
    for line in cautions:
        tell(f"caution: {line}")
    return cautions


def _processor(scene: Scene, *, talks: bool) -> tuple[str, ...]:
    """A line where the scene's boards would need more time than their processor has."""
    from cell_firmware.processor_time import period_e, shares
    from deploy.motors import told

    sides = int((scene.lattice().neighbours >= 0).sum(axis=1).max()) if talks else 0
    period_ns = scene.cells.period_ns
    takes = shares(scene.effects, told(scene.effects.motors), period_ns, sides)
    if not takes:
        return ()
    whole = period_e(period_ns)
    least, most = (
        sum(bound) / whole for bound in zip(*((one.least, one.most) for one in takes), strict=True)
    )
    if most <= 1.0:
        return ()
    parts = ", ".join(f"{one.what} {_percent(one.least / whole, one.most / whole)}" for one in takes)
    line = (
        f"an MC68HC11 would be busy for {_percent(least, most)} of a control period of {whole:,.0f} E: {parts}; "
        "the emulation takes no time for it, and a real board would miss periods and bytes"
    )
    return (line,)


def _percent(least: float, most: float) -> str:
    low, high = round(100 * least), round(100 * most)
    return f"{low} %" if low == high else f"{low} to {high} %"


def cautions_of_registers(scene: Scene) -> tuple[str, ...]:
    """A line where registers are to be recorded and the program's variables can't be, or not all of them."""
    from cell_firmware.cell import PerCell
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    if not isinstance(firmware, PerCell):
        return ()
    try:
        problem = firmware.unrecorded(_first_cell(scene))
    except Exception:  # noqa: BLE001 - its cells fail as they begin, and say with what
        return ()
    return () if problem is None else (f"--registers: {Path(scene.cells.firmware).name}: {problem}",)


def _first_cell(scene: Scene) -> Cells:
    from cell_firmware.firmware import Cells
    from plant.array import CellArray

    array = CellArray(scene.array)
    cells = Cells.of(
        array.lattice,
        array.positions_m,
        scene.cells.period_s,
        scene.array.sensors_m,
        pitch_m=array.pitch_m,
    )
    return cells.take(np.array([0]))
