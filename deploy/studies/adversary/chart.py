"""Message sequence chart of a counterexample: the last ticks before the violation."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

from deploy.plots.kinds import PlotSelection, draw_kind
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions

if TYPE_CHECKING:
    from deploy.studies.adversary.check import Counterexample

_TICKS: Final = 12
"""Most ticks of a chart."""
_CELLS: Final = 9
"""Most cells of a chart; of larger worlds those with a fault and those of the violation are drawn."""


def draw_counterexample(found: Counterexample, scene: Path, chart: Path) -> bool:
    """Run a counterexample once more, in this process, and draw the messages of its last ticks.

    Args:
        found: The counterexample.
        scene: Scene file that it was written to.
        chart: Picture to write, PNG, SVG or PDF by its suffix.

    Returns:
        False, with no picture, where its program sends no messages.

    Raises:
        DeployError: The file can't be written.
    """
    from cell_firmware.loader import load as load_firmware

    if load_firmware(found.scene.cells).message is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        options = RunOptions(
            0, "memory", output=Path(folder), picture=False, trace_messages="all", check="stop"
        )
        run(load_scene(str(scene)), options, quiet=True)
        recording = load(folder)
        last = int(recording.tick[-1])
        selection = PlotSelection(cells=_cells(found), ticks=(max(last - _TICKS + 1, 0), last))
        draw_kind(recording, "sequence", chart, selection)
    return True


def _cells(found: Counterexample) -> str | None:
    """Return the cells to draw; None: all."""
    names = found.scene.lattice().cells
    if len(names) <= _CELLS:
        return None
    chosen = dict.fromkeys(found.violation.cells)
    for table in found.faults:
        cell = table.get("cell")
        chosen |= dict.fromkeys([tuple(cell)] if cell is not None else [])
    return " ".join(f"{row},{column}" for row, column in list(chosen)[:_CELLS])
