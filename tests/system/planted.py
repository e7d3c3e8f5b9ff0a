"""Random programs with one planted fault, and what a run of each must come to: exit status, message, recording."""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from bus.random_streams import rng
from deploy.cli import main
from deploy.recordings.reader import load
from tests.system.small import small_scene

Kind = Literal[
    "nothing", "typo", "wrong field", "nan", "raise", "wrong shape", "endless loop", "long sleep", "sys.exit",
    "interrupt", "huge message",
]  # fmt: skip
KINDS: tuple[Kind, ...] = get_args(Kind)
Form = Literal["cell", "array"]
Way = tuple[str, ...]

ROWS, COLUMNS, TICKS = 3, 4, 49
DEADLINE_S = 1.0
ONE: Way = ("--processes", "0", "--transport", "memory")
WAYS: tuple[tuple[Way, float], ...] = (
    (ONE, 0.6),
    (("--processes", "0", "--wire", "per_cell"), 0.1),
    (("--processes", "2"), 0.15),
    (("--processes", "3", "--wire", "per_cell"), 0.05),
    (("--processes", "each"), 0.1),
)

CELL = """
import sys, time
import numpy as np
from cell_firmware.cell import CellFirmware, CellOutputs

class Planted(CellFirmware):
    message = np.dtype([("heat", "<f8"), ("count", "<i4")])

    def init(self, cell):
        return {{"place": (cell.row, cell.column), "tick": 0}}

    def step(self, state, inputs):
        speed, count, heat, name = (0.1, 0.0), 1, 0.5, "heat"
        if state["tick"] == {tick} and state["place"] in {cells}:
            {fault}
        heard = sum(one["count"] for one in inputs.inbox.values() if one is not None)
        outbox = dict.fromkeys(inputs.inbox, {{name: heat + heard, "count": count}})
        return {{**state, "tick": state["tick"] + 1}}, CellOutputs(speed, outbox)
"""
ARRAY = """
import sys, time
import numpy as np
from cell_firmware.firmware import Firmware, Outbox, Outputs

class Planted(Firmware):
    message = np.dtype([("heat", "<f8"), ("count", "<i4")])

    def init(self, cells):
        hit = [place in {cells} for place in zip(cells.row.tolist(), cells.column.tolist())]
        return {{"hit": np.array(hit), "tick": np.zeros(len(cells), dtype=np.int64)}}

    def step(self, state, inputs):
        n = len(state["tick"])
        speed, count = np.tile([0.1, 0.0], (n, 1)), 1
        hit = state["hit"] & (state["tick"] == {tick})
        if hit.any():
            {fault}
        message = np.zeros((n, 4), dtype=self.message)
        message["count"] = count
        outbox = Outbox(np.ones((n, 4), dtype=np.bool_), message)
        return {{"hit": state["hit"], "tick": state["tick"] + 1}}, Outputs(speed, outbox)
"""
FAULTS: dict[Form, dict[Kind, str]] = {
    "cell": {
        "nothing": "pass",
        "typo": "inputs.presense",
        "wrong field": "name = 'haet'",
        "nan": "speed = (float('nan'), 0.0)",
        "raise": "raise RuntimeError('stuck')",
        "wrong shape": "speed = (0.1, 0.0, 0.0)",
        "endless loop": "while True: pass",
        "long sleep": "time.sleep(4)",
        "sys.exit": "sys.exit()",
        "interrupt": "raise KeyboardInterrupt",
        "huge message": "count = 10**30",
    },
    "array": {
        "nothing": "pass",
        "typo": "inputs.presense",
        "wrong field": "state['haet']",
        "nan": "speed[hit] = np.nan",
        "raise": "raise RuntimeError('stuck')",
        "wrong shape": "speed = np.zeros((n, 3))",
        "endless loop": "while True: pass",
        "long sleep": "time.sleep(4)",
        "sys.exit": "sys.exit(0)",
        "interrupt": "raise KeyboardInterrupt",
        "huge message": "count = np.where(hit, 10**12, 1)[:, None]",
    },
}
SAID: dict[Form, dict[Kind, str]] = {
    "cell": {
        "typo": "AttributeError: 'CellInputs' object has no attribute 'presense'",
        "wrong field": "haet",
        "nan": "drive is not finite: speed [nan, 0.0] m/s",
        "raise": "RuntimeError: stuck",
        "wrong shape": "speed_m_s must be two numbers",
        "endless loop": "NeverReturned: the step had not returned after 1 s (stall.deadline_s)",
        "long sleep": "NeverReturned: the step had not returned after 1 s (stall.deadline_s)",
        "sys.exit": "SystemExit",
        "interrupt": "KeyboardInterrupt",
        "huge message": "must be a whole number from -2147483648 to 2147483647 (int32)",
    },
    "array": {
        "typo": "AttributeError: 'Inputs' object has no attribute 'presense'",
        "wrong field": "KeyError: 'haet'",
        "nan": "drive is not finite: speed [nan, nan] m/s",
        "raise": "RuntimeError: stuck",
        "wrong shape": "speed_m_s must be real numbers of shape",
        "endless loop": "NeverReturned: the step had not returned after 1 s (stall.deadline_s)",
        "long sleep": "NeverReturned: the step had not returned after 1 s (stall.deadline_s)",
        "sys.exit": "SystemExit: 0",
        "interrupt": "KeyboardInterrupt",
        "huge message": "message field count to the north is 1000000000000: must be a whole number from -2147483648",
    },
}
"""What the message must say, by form and kind."""
HANGS = ("endless loop", "long sleep")
"""Kinds that meet the deadline; the others get a long one, so that a busy machine changes nothing."""
RAISES = ("typo", "raise", "endless loop", "long sleep", "sys.exit", "interrupt")
"""Kinds of which a traceback is shown in either form."""


@dataclass(frozen=True)
class Planted:
    """A program with a fault in it, and how it is run.

    Attributes:
        kind: The fault.
        form: Of the program.
        tick: In which it shows.
        cells: In which cells, row-major.
        way: Options of ``mdms run``.
        isolated: Whether the scene says ``cells.on_failure = "isolate"``.
    """

    kind: Kind
    form: Form
    tick: int
    cells: tuple[tuple[int, int], ...]
    way: Way
    isolated: bool = False

    @staticmethod
    def drawn(seed: int) -> Planted:
        """The program of a seed; kinds take turns."""
        draw = rng(seed, "planted faults")
        every = [(row, column) for row in range(ROWS) for column in range(COLUMNS)]
        count = int(draw.choice([1, 2, 5, len(every)]))
        cells = sorted(draw.choice(len(every), count, replace=False).tolist())
        kind = KINDS[seed % len(KINDS)]
        shares = [share for _, share in WAYS]
        way = WAYS[int(draw.choice(len(WAYS), p=shares))][0]
        if kind == "long sleep":  # what can't be interrupted is named alone
            cells = cells[:1]
        if kind == "endless loop" and "each" in way:  # a dozen busy processes keep the others from answering
            cells = cells[:2]
        return Planted(
            kind,
            "cell" if draw.random() < 0.5 else "array",
            int(draw.integers(0, TICKS)),
            tuple(every[cell] for cell in cells),
            way,
            isolated=kind != "long sleep" and bool(draw.random() < 0.15),
        )

    @property
    def named(self) -> tuple[int, int]:
        """The cell that the message must name."""
        if self.kind == "long sleep" and self.form == "array":
            return self._together
        return self.cells[0]

    @property
    def _together(self) -> tuple[int, int]:
        """The first of the cells that are stepped in one call with the one that sleeps."""
        processes = self.way[1]
        shards = ROWS * COLUMNS if processes == "each" else max(int(processes), 1)
        size = ROWS * COLUMNS // shards
        row, column = self.cells[0]
        return divmod((row * COLUMNS + column) // size * size, COLUMNS)


def carry_out(planted: Planted, folder: Path) -> list[str]:
    """Run a program; what is not as it must be, a line each."""
    template = CELL if planted.form == "cell" else ARRAY
    fault = FAULTS[planted.form][planted.kind]
    program = folder / "planted.py"
    program.write_text(template.format(tick=planted.tick, cells=set(planted.cells), fault=fault))
    scene = folder / "small.toml"
    scene.write_text(small_scene())
    settings = [
        f'cells={{ firmware = "{program}", on_failure = "{"isolate" if planted.isolated else "stop"}" }}',
        f"stall.deadline_s={DEADLINE_S if planted.kind in HANGS else 30.0}",
    ]
    output = folder / "out"
    arguments = ["run", str(scene), "-q", "--json", "--no-picture", "--output", str(output), *planted.way]
    for setting in settings:
        arguments += ["--set", setting]
    stdout, stderr = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
        status = main(arguments)
    try:
        summary: dict[str, Any] = json.loads(stdout.getvalue())
    except ValueError:
        return [f"no summary, exit status {status}: {stderr.getvalue()}"]
    wrong = _outcome(planted, status, summary, stderr.getvalue())
    recording = load(output)
    if (recording.status, recording.digest) != (summary["status"], summary["digest"]):
        wrong.append(f"the recording says {recording.status}, {recording.digest}, not as the summary")
    if recording.tick.tolist() != list(range(summary["ticks"] + 1)):
        wrong.append(f"the recording has ticks {recording.tick.tolist()}, not {summary['ticks']} and the end")
    return wrong


def _outcome(planted: Planted, status: int, summary: dict[str, Any], said: str) -> list[str]:
    wrong: list[str] = []

    def must(what: str, found: object, expected: object) -> None:
        if found != expected:
            wrong.append(f"{what} is {found!r}, not {expected!r}")

    lost = [list(cell) for cell in planted.cells]
    if planted.kind == "nothing":
        must("exit status", status, 0)
        must("the end", (summary["status"], summary["ticks"], summary["cells_lost"]), ("ok", TICKS, []))
        must("stderr", said, "")
        return wrong
    last = said.splitlines()[-1] if said else ""
    if planted.isolated:
        all_gone = len(lost) == ROWS * COLUMNS
        must("exit status", status, int(all_gone))
        must("status", summary["status"], "failed" if all_gone else "ok")
        must("ticks", summary["ticks"], TICKS)
        must("cells lost", summary["cells_lost"], lost)
        if all_gone and not last.startswith("mdms: failed: no cell was alive at the end: cells 0,0 "):
            wrong.append(f"the last line is {last!r}")
        return wrong
    must("exit status", status, 1)
    must("status", (summary["status"], summary["ticks"]), ("failed", planted.tick))
    must("the last line", last, f"mdms: failed: {summary['reason']}")
    row, column = planted.named
    begins = f"mdms: failed: the program of cell {row},{column} failed in tick {planted.tick} ("
    if not last.startswith(begins) or SAID[planted.form][planted.kind] not in last:
        wrong.append(f"the last line is {last!r}")
    more = len(planted.cells) - 1
    ends = f"; {more} cell{'s' if more > 1 else ''} more failed in that tick"
    if last.endswith(" failed in that tick") != bool(more) or (more and not last.endswith(ends)):
        wrong.append(f"the last line doesn't say that {more} more failed: {last!r}")
    if planted.kind in RAISES and "Traceback (most recent call last):" not in said:
        wrong.append("no traceback is shown")
    return wrong
