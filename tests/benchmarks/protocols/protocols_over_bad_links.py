"""What protocols come to where messages get lost or late, clocks drift and cells die: errors, bias, pace.

``python tests/benchmarks/protocols/protocols_over_bad_links.py`` prints its method and its figures; names of cases may
follow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.fault import FaultInstance
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.controller import Controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.clock.mailbox import Mailbox
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.kinds.link_loss import LinkLossFault
from cell_firmware.firmware import Cells, Firmware
from cell_firmware.loader import load
from cell_firmware.shard import FAULTS, Shard
from cell_firmware.specs import CellsSpec
from cell_firmware.toolkit.stencil import across, gradient

Floats = NDArray[np.float64]

ROWS, COLUMNS, TICKS, LAST, DIE = 5, 8, 1200, 100, 200
PITCH_M = 0.1
CONDITIONS: dict[str, dict[str, Any]] = {
    "as they are": {},
    "loss 0.05": {"link_loss": {"probability": 0.05}},
    "loss 0.2": {"link_loss": {"probability": 0.2}},
    "bursts of 30": {"bursts": {"probability": 0.2, "burst_ticks": 30.0}},
    "delay 4": {"link_delay": {"ticks": 4}},
    "delay 0 to 4": {"link_delay": {"between_ticks": [0, 4]}},
    "clocks 5 %": {"clock": {"error_ppm": 50_000.0}},
    "dead 10 %": {"dead": 0.1},
}
METHOD = f"""\
Method. {{arrays}} arrays of {ROWS} x {COLUMNS} cells side by side, no link between them, each with losses, delays,
clocks and deaths of its own by the seed; {TICKS} ticks. "bursts of 30": a fifth of all messages is lost, 30 in a row in
the mean (Gilbert's model). "dead 10 %": {{dead}} cells of every array die in tick {DIE},
drawn from those that hold or feed nothing (for max_consensus from all others, and the leader with them). The right
answer is theory's limit on the cells that live. "error": the greatest distance of a living cell from it in the last
{LAST} ticks, by the limit's range, in the median array and in the worst; "bias": the greatest of a cell's means, over
arrays and those ticks, beside what the arrays' scatter alone makes of it (one standard deviation); "settled": the first
tick from which the error stays below 1 %, in the median array and in the worst; - for never.
average_consensus: "error" is in units of what it averages, 1 in the left column and 0 elsewhere. max_consensus: "error"
is the share of cells in those ticks that follow another than the leader. wave, undamped: "error" is the root mean
square speed in those ticks by that on perfect links.
"""


@dataclass(frozen=True)
class Case:
    """A protocol and its task.

    Attributes:
        firmware: Its bundled name.
        parameters: Its parameters, alike for every array: places are columns.
        spared: Cells of an array that do not die.
        answer: What is held against the drive instead of the observed field, of a lattice and theory's limit.
    """

    firmware: str
    parameters: dict[str, Any]
    spared: Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]
    answer: Callable[[Lattice, Floats], Floats] | None = None


def edges(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.bool_]:
    del row
    return (column == 0) | (column == COLUMNS - 1)


def nobody(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.bool_]:
    del column
    return np.zeros(len(row), dtype=np.bool_)


def flow(lattice: Lattice, potential: Floats) -> Floats:
    """Wheel speeds that a potential makes, ``(n, 2)`` m/s."""
    faces = across(lattice.neighbours >= 0, potential[lattice.neighbours], potential)
    return -gradient(faces, np.full(len(lattice), PITCH_M))


LEFT, RIGHT = {"columns": [0, 0]}, {"columns": [COLUMNS - 1, COLUMNS - 1]}
SPEEDS = {"held": [{**LEFT, "speed_m_s": [0.3, 0.0]}, {**RIGHT, "speed_m_s": [0.0, 0.0]}]}
POTENTIALS = {"held": [{**LEFT, "value": 1.0}, {**RIGHT, "value": 0.0}]}
SOURCES = {"sources": [{**LEFT, "flow_m2_s": 0.02}, {**RIGHT, "flow_m2_s": -0.02}]}
VALUES = {"values": [{**LEFT, "value": 1.0}]}
BUMP = {"initial": [{"columns": [2, 3], "speed_m_s": [0.3, 0.0]}]}
CASES: dict[str, Case] = {
    "heat_diffusion": Case("heat_diffusion", SPEEDS, edges),
    "heat_diffusion, ttl_periods 20": Case("heat_diffusion", {**SPEEDS, "ttl_periods": 20}, edges),
    "wave, damping 0": Case("wave", BUMP, nobody),
    "wave, damping 0.2, ttl_periods 20": Case("wave", {**SPEEDS, "damping": 0.2, "ttl_periods": 20}, edges),
    "wave, damping 0.6, ttl_periods 20": Case("wave", {**SPEEDS, "damping": 0.6, "ttl_periods": 20}, edges),
    "laplace": Case("laplace", POTENTIALS, edges),
    "laplace, relaxation 1.4": Case("laplace", {**POTENTIALS, "relaxation": 1.4}, edges),
    "stream": Case("stream", SOURCES, edges, flow),
    "stream, relaxation 1.4": Case("stream", {**SOURCES, "relaxation": 1.4}, edges, flow),
    "average_consensus": Case("average_consensus", VALUES, nobody),
    "max_consensus": Case("max_consensus", {"lifetime": 100}, nobody),
}


def side_by_side(arrays: int) -> Lattice:
    """Arrays above each other, a row of no cells between them."""
    return Lattice(
        (one * (ROWS + 1) + row, column)
        for one in range(arrays)
        for row in range(ROWS)
        for column in range(COLUMNS)
    )


def who_dies(case: Case, lattice: Lattice, share: float, seed: int) -> NDArray[np.int64]:
    """Indices of the cells that die: as many in every array."""
    count = round(share * ROWS * COLUMNS)
    dead: list[int] = []
    if not count:
        return np.array(dead, dtype=np.int64)
    for one in range(len(lattice) // (ROWS * COLUMNS)):
        cells = np.arange(ROWS * COLUMNS) + one * ROWS * COLUMNS
        mortal = cells[~case.spared(lattice.rows[cells], lattice.columns[cells])]
        leader = [int(cells[-1])] if case.firmware == "max_consensus" else []
        chance = np.random.default_rng([seed, one])
        others = np.setdiff1d(mortal, leader)
        dead += leader + chance.choice(others, count - len(leader), replace=False).tolist()
    return np.array(sorted(dead))


def shard_of(
    firmware: Firmware, lattice: Lattice, effects: CellEffects, bursts: dict[str, float] | None, seed: int
) -> Shard:
    """All cells in one shard, with clocks and bursts of losses where they are asked for."""
    spec = CellsSpec()
    position = PITCH_M * np.stack((lattice.columns, lattice.rows), axis=1)
    cells = Cells.of(lattice, position, spec.period_s, pitch_m=PITCH_M)
    partition = Partition.even(lattice, 1)
    assert firmware.message is not None
    controller: Controller = Board(firmware)
    if effects.clock is not None:
        clocks = effects.clock.clocks(lattice, spec.period_ns, seed)
        controller = LocalClockWrapper(
            Board(firmware, None, Mailbox(firmware.message, clocks.clocks.window_ns)), clocks
        )
    site = ShardContext(partition.cells(0), 1, controller.link_type, seed)
    stages = effects.input_filters(site)
    if bursts is None:
        return Shard(controller, cells, partition, 0, stages)
    fault = LinkLossFault.model_validate({"share": 1.0, **bursts})
    one = FaultInstance[CellFault](0, fault, np.arange(len(lattice)), 0)
    stages[FAULTS] = tuple(fault.input_filters(site, lattice, one))
    return Shard(controller, cells, partition, 0, stages, (one,))


def watched(
    case: Case, asked: dict[str, Any], arrays: int, seed: int, ticks: int = TICKS
) -> tuple[Floats, Floats]:
    """The field ``(ticks, n, components)``, NaN in dead cells, and what it should come to, ``(n, components)``."""
    lattice = side_by_side(arrays)
    firmware = load(CellsSpec(firmware=case.firmware, parameters=case.parameters))
    effects = CellEffects.model_validate({key: asked[key] for key in asked.keys() - {"dead", "bursts"}})
    dead = who_dies(case, lattice, asked.get("dead", 0.0), seed)
    living = Lattice(cell for i, cell in enumerate(lattice.cells) if i not in set(dead.tolist()))
    alive = lattice.find(living.rows, living.columns)
    theory = firmware.theory(living)
    speeds = np.zeros((len(living), 2))  # of waves that last there is no limit
    limit = speeds if theory is None or theory.limit is None else theory.limit
    right = limit if case.answer is None else case.answer(living, limit)
    wanted = np.full((len(lattice), *right.shape[1:]), np.nan)
    wanted[alive] = right

    shard = shard_of(firmware, lattice, effects, asked.get("bursts"), seed)
    nothing = np.zeros((len(lattice), 1), dtype=np.bool_)
    found = np.full((ticks, *wanted.shape), np.nan)
    for tick in range(ticks):
        if tick == DIE:
            shard.retire(lattice.cells[i] for i in dead.tolist())
        drive = shard.step(tick, nothing).drive
        cells, registers = shard.registers()
        rows = lattice.find(cells[:, 0], cells[:, 1])
        seen = drive[rows] if case.answer else registers[f"firmware.{firmware.observable}"]
        found[tick, rows] = seen
    found[:, dead] = np.nan
    return found.reshape(ticks, len(lattice), -1), wanted.reshape(len(lattice), -1)


def figures(case: Case, asked: dict[str, Any], arrays: int, seed: int) -> dict[str, float]:
    """What the table shows."""
    found, wanted = watched(case, asked, arrays, seed)
    if case.firmware == "max_consensus":
        off = np.where(np.isnan(wanted), np.nan, (found != wanted).any(axis=2, keepdims=True))
    elif case.firmware == "wave" and "damping" not in case.parameters:
        usual, _ = watched(case, {}, arrays, seed)
        size = np.sqrt((usual.reshape(TICKS, arrays, -1)[-LAST:] ** 2).mean(axis=(0, 2)))
        with np.errstate(over="ignore"):
            now = np.sqrt(np.nanmean(found.reshape(TICKS, arrays, -1)[-LAST:] ** 2, axis=(0, 2)))
        return {"median": float(np.median(now / size)), "worst": float((now / size).max())}
    else:
        off = (found - wanted) / np.nanmax(np.ptp(np.nan_to_num(wanted), axis=0))
        if case.firmware == "average_consensus":
            off = found - wanted
    each = off.reshape(TICKS, arrays, ROWS * COLUMNS, -1)
    error = np.nanmax(abs(each), axis=(2, 3))
    late = error[-LAST:].max(axis=0)
    if case.firmware == "max_consensus":
        late = np.nanmean(each[-LAST:], axis=(0, 2, 3))
    means = each[-LAST:].mean(axis=0)  # NaN in dead cells
    bias = np.nanmax(abs(np.nanmean(means, axis=0)))
    scatter = np.nanmax(np.nanstd(means, axis=0)) / np.sqrt(arrays)
    unsettled = np.where(error >= 0.01, np.arange(1, TICKS + 1)[:, None], 0).max(axis=0)
    return {
        "median": float(np.median(late)),
        "worst": float(late.max()),
        "bias": float(bias),
        "scatter": float(scatter),
        "settled": float(np.median(unsettled)),
        "last": float(unsettled.max()),
    }


def shown(row: dict[str, float]) -> str:
    """A line of the table."""
    errors = f"{row['median']:10.1e}{row['worst']:10.1e}"
    if "bias" not in row:
        return errors
    ticks = "".join(f"{row[name]:8.0f}" if row[name] < TICKS else f"{'-':>8}" for name in ("settled", "last"))
    return f"{errors}{row['bias']:10.1e}{row['scatter']:10.1e}{ticks}"


def through_bursts(case: Case, arrays: int, seed: int) -> None:
    """Prints how a protocol that should come to its limit does so while links go on losing bursts of messages."""
    ends = (600, 1200, 3000)
    ticks = "".join(f"{f'{end - LAST}-{end}':>22}" for end in ends)
    print(
        f"greatest error of a cell in these ticks, in the median array and in the worst\n{'share, burst':16}{ticks}"
    )
    for share, mean in ((0.2, 10.0), (0.2, 30.0), (0.3, 60.0), (0.5, 100.0)):
        asked = {"bursts": {"probability": share, "burst_ticks": mean}}
        found, wanted = watched(case, asked, arrays, seed, ends[-1])
        error = abs(found - wanted).reshape(ends[-1], arrays, -1).max(axis=2)
        late = [error[end - LAST : end].max(axis=0) for end in ends]
        row = "".join(f"{np.median(one):11.1e}{one.max():11.1e}" for one in late)
        print(f"{f'{share:g}, {mean:g}':16}{row}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help=f"of {'; '.join(CASES)}; default: all")
    parser.add_argument("--bursts", action="store_true", help="bursts of losses of several lengths instead")
    parser.add_argument("--arrays", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print(METHOD.format(arrays=asked.arrays, dead=round(0.1 * ROWS * COLUMNS)))
    head = f"{'':16}{'error':>10}{'worst':>10}{'bias':>10}{'scatter':>10}{'settled':>8}{'last':>8}"
    for name in asked.cases or CASES:
        if asked.bursts:
            print(name)
            through_bursts(CASES[name], asked.arrays, asked.seed)
            continue
        print(f"{name}\n{head}")
        for condition, what in CONDITIONS.items():
            print(f"{condition:16}{shown(figures(CASES[name], what, asked.arrays, asked.seed))}", flush=True)


if __name__ == "__main__":
    main()
