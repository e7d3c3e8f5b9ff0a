"""Runs with a process a cell and packed runs, for ``fast.py``, beside a bare exchange of the same bytes."""

from __future__ import annotations

import itertools
import os
import re
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fast_bare import BareExchange, Exchange
from fast_helics import helics_rate

from bus.partition import Partition
from bus.wire.formats import WireFormat
from cell_firmware.loader import load
from deploy.recordings.digest import Digest
from deploy.recordings.run_log import RunLog
from deploy.recordings.writer import Recorder
from deploy.runs.backends import Workers
from deploy.runs.output import recording_header
from deploy.runs.setup import sensor_schema
from deploy.runs.simulation import Simulation
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.util.progress import Progress
from plant.tick import TickHooks

WARM_TICKS = 5


@dataclass(frozen=True)
class Case:
    """A run to measure.

    Attributes:
        title: What it is.
        scene: Name of a bundled scene.
        rows, columns: Of the array; 0: the scene's, with a cell a worker.
        workers: Processes of cells.
        recorded: Whether it is recorded.
        changes: Further values of the scene.
        form: Wire format.
        must: Least ratio to the other side's rate; None: it is only printed.
        beside: The other side: ``bare``, a Zenoh exchange of the payloads that the run sends; ``by_key``, one of the
            same values with a payload per cell and link; or ``helics``.
        goal: Ticks a second to reach on two quiet cores; None: none.
    """

    title: str
    scene: str
    rows: int
    columns: int
    workers: int
    recorded: bool
    changes: tuple[tuple[str, Any], ...] = ()
    form: WireFormat = "packed"
    must: float | None = None
    goal: float | None = None
    beside: Literal["bare", "by_key", "helics"] = "bare"

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.rows * self.columns if self.rows else self.workers

    def loaded(self) -> Scene:
        """Return the scene."""
        values = (("duration_s", 1e5), *self.changes)
        if self.rows:
            values += (("array.rows", self.rows), ("array.columns", self.columns))
        return load_scene(self.scene, [Override(tuple(key.split(".")), value, key) for key, value in values])


def _diffusion(columns: int, apart: int) -> tuple[tuple[str, Any], ...]:
    """Values that have wheel speed spread from held columns."""
    held = [{"columns": [at, at], "speed_m_s": [0.05, 0.0]} for at in range(0, columns, apart)]
    return (
        ("cells.firmware", "heat_diffusion"),
        ("cells.parameters", {"diffusion_number": 0.2, "held": held}),
    )


MOVING = (("effects.motors", {}), *_diffusion(100, 10))
"""Motors, speed loops and diffusion under the parcels of ``large``, which all end up at the speed of held columns."""


def _packed() -> Iterator[Case]:
    """Yield packed cases: each size with one worker and with two, and what is asked of 10,000 cells.

    10,000 cells without recording and digest, too: what these take of the largest runs that have them.
    """
    sizes = ((25, 40, True, 0.6, 2500.0), (100, 100, True, 0.6, None), (250, 400, False, 0.4, 100.0))
    for rows, columns, recorded, must, goal in (*sizes, (1000, 1000, False, 0.4, 8.0)):
        for workers in (1, 2):
            title = f"heat, {rows * columns:,} cells, {workers} worker{'s' * (workers > 1)}"
            changes = _diffusion(columns, columns - 1)
            form: WireFormat = "packed" if workers == 1 else "relayed"  # the default of mdms run
            yield Case(title, "heat", rows, columns, workers, recorded, changes, form, must, goal)
            if rows == 100:
                yield Case(f"{title}, not recorded", "heat", rows, columns, workers, False, changes, form)
    for workers in (1, 2):
        title = f"50 parcels, motors, 10,000 cells, {workers} worker{'s' * (workers > 1)}"
        form = "packed" if workers == 1 else "relayed"
        yield Case(title, "large", 100, 100, workers, True, MOVING, form, None, 500.0)


def _heat(columns: int) -> tuple[tuple[str, Any], ...]:
    """Values of ``heat`` with one small parcel."""
    parcel = {"size_m": [0.2, 0.2], "mass_kg": 1.0, "position_m": [0.0, 0.0]}
    return (("parcels", [parcel]), *_diffusion(columns, columns - 1))


def _each(beside: Literal["bare", "by_key"]) -> Iterator[Case]:
    """Yield cases with a process a cell: the boards of the prototype, and heat on more and more cells."""
    yield Case("prototype, 18 processes", "prototype", 0, 0, 18, True, (), "relayed", 0.5, 600.0, beside)
    for rows, columns in ((3, 6), (8, 8), (8, 16), (16, 16)):
        processes = rows * columns
        title = f"heat, {processes} processes"
        yield Case(
            title, "heat", rows, columns, processes, True, _heat(columns), "relayed", 0.6, None, beside
        )


def _helics() -> Iterator[Case]:
    """Yield cases beside HELICS."""
    for processes, must in ((18, 1.4), (64, 8.0)):
        title, changes = f"prototype, {processes} processes", ()
        if processes > 18:
            title, changes = f"heat, {processes} processes", _heat(8)
        scene, rows = ("prototype", 0) if processes == 18 else ("heat", 8)
        yield Case(title, scene, rows, rows, processes, True, changes, "relayed", must, None, "helics")


CASES = {
    "each": tuple(_each("bare")),
    "by_key": tuple(_each("by_key")),
    "packed": tuple(_packed()),
    "helics": tuple(_helics()),
}


class Run:
    """The real run: workers with real cells, and the plant in this process, as ``mdms run`` has them."""

    def __init__(self, case: Case, stack: ExitStack) -> None:
        scene = case.loaded()
        self.simulation = stack.enter_context(Simulation.open(scene, Workers(case.workers, case.form)))
        self._process = self.simulation.process
        plant = self.simulation.plant
        message = load(scene.cells).message
        self.partition = Partition.even(plant.array.lattice, case.workers)
        self.exchange = Exchange.of(
            self.partition,
            "per_cell" if case.beside == "by_key" else case.form,
            sensor_schema(scene, plant.sense()),
            message,
        )
        if case.recorded:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            header = recording_header("benchmark", scene, plant.array, plant.footprints_m)
            recorder = stack.enter_context(Recorder(folder, header))
            progress = stack.enter_context(Progress(scene.duration_ns, quiet=True))
            log = RunLog(
                plant.array.lattice.cells,
                scene.tick_ns,
                digest=Digest(scene.canonical()),
                recorder=recorder,
                progress=progress,
                policy=scene.stall.policy,
                warn=lambda line: None,
            )
            self.simulation.add_hooks(TickHooks(after_tick=(log.tick,)))

    def tick(self) -> None:
        """Run a tick; the one before is recorded on the way, as in a run."""
        ended = self._process.step()
        if ended is not None:
            raise SystemExit(f"the run is over: {ended}")


def _threads(pid: int, name: str) -> Iterator[str]:
    """Yield a file of every thread of a process; threads that end meanwhile have none."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):
            yield (task / name).read_text()


def descendants(pid: int) -> Iterator[int]:
    """Yield the processes that a process has started, and those that they have."""
    for children in _threads(pid, "children"):
        for child in map(int, children.split()):
            yield child
            yield from descendants(child)


def spent_us(pids: list[int]) -> float:
    """Return the processor time of all threads of some processes."""
    return sum(int(stat.split()[0]) for pid in pids for stat in _threads(pid, "schedstat")) / 1e3


def pss_mb(pid: int) -> float:
    """Return a process's memory, pages that it shares divided by those that share them."""
    found = re.search(r"^Pss:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.MULTILINE)
    return int(found[1]) / 1024 if found else 0.0


@dataclass
class Turns:
    """Figures of one side, turn by turn.

    Attributes:
        rates: Ticks a second.
        plant_us, workers_us: Processor time a tick.
    """

    rates: list[float]
    plant_us: list[float]
    workers_us: list[float]

    def take(self, tick: Callable[[], None], pids: list[int], seconds: float) -> None:
        """Run ticks for so long, two at least."""
        me = [os.getpid()]
        plant, workers, begun = spent_us(me), spent_us(pids), time.perf_counter()
        for ticks in itertools.count(1):
            tick()
            if ticks > 1 and time.perf_counter() - begun >= seconds:
                break
        self.rates.append(ticks / (time.perf_counter() - begun))
        self.plant_us.append((spent_us(me) - plant) / ticks)
        self.workers_us.append((spent_us(pids) - workers) / ticks)

    def medians(self) -> dict[str, float]:
        """Return the medians over the turns."""
        return {
            "ticks_per_s": statistics.median(self.rates),
            "plant_us": statistics.median(self.plant_us),
            "workers_us": statistics.median(self.workers_us),
        }


def _beside_bare(run: Run, bare: Turns, stack: ExitStack) -> Callable[[float], None]:
    """Return a turn of the bare exchange."""
    exchange = BareExchange(run.exchange)
    stack.callback(exchange.close)
    for _ in range(WARM_TICKS):
        exchange.tick()
    return lambda seconds: bare.take(exchange.tick, exchange.pids, seconds)


def _beside_helics(run: Run, bare: Turns) -> Callable[[float], None]:
    """Return a turn of HELICS, whose processor time is not taken."""
    neighbours = [[i for i in row if i >= 0] for row in run.partition.lattice.neighbours.tolist()]
    sizes = max(run.exchange.senses), max(run.exchange.drives)

    def take(seconds: float) -> None:
        bare.rates.append(helics_rate(neighbours, *sizes, seconds))
        bare.plant_us.append(0.0)
        bare.workers_us.append(0.0)

    return take


def measure(case: Case, turns: int, seconds: float) -> dict[str, Any]:
    """Return the figures of a case, taken in this process."""
    real, bare = Turns([], [], []), Turns([], [], [])
    with ExitStack() as stack:
        run = Run(case, stack)
        cells = list(descendants(os.getpid()))
        for _ in range(WARM_TICKS):
            run.tick()
        pss = sum(map(pss_mb, (os.getpid(), *cells)))
        other = _beside_helics(run, bare) if case.beside == "helics" else _beside_bare(run, bare, stack)
        for turn in range(turns):
            pair = [lambda: real.take(run.tick, cells, seconds), lambda: other(seconds)]
            for take in pair if turn % 2 == 0 else reversed(pair):
                take()
    ratios = [ours / theirs for ours, theirs in zip(real.rates, bare.rates, strict=True)]
    return {
        "title": case.title,
        "cells": case.cells,
        "workers": case.workers,
        "recorded": case.recorded,
        "bytes_a_tick": run.exchange.bytes_a_tick,
        "real": real.medians(),
        "bare": bare.medians(),
        "ratio": statistics.median(ratios),
        "ratio_range": [min(ratios), max(ratios)],
        "must": case.must,
        "goal": case.goal,
        "pss_mb": pss,
    }
