"""Traces ticks of a run and lists the files of ours that a message, a drive and live faults pass.

``python tests/tools/trace_tick.py`` prints the lists at the end of docs/tick.md; ``--json`` prints them as JSON.

Two cells, each a shard with a thread, and the plant in the main thread; the memory transport connects them. All parts
are assembled by the product's own code, except for the queue of requests, which needs a Zenoh session, and the log.
A program sends and drives marked numbers in one tick, and the request for a fault has marked fields. A profile function
looks at every call of a function of ours and at every return: a file is on the path if the arguments, local variables
or the result contain a mark. Files are listed in the order of first appearance in a thread.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import struct
import sys
import threading
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any, Final

import numpy as np
from pydantic import BaseModel

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bus.lockstep import WireFormat
from bus.partition import Partition
from bus.transports.memory import MemoryEndpoint
from cell_firmware.faults.base import CellFault
from deploy.control.server import ControlServer
from deploy.faults.registry import KINDS
from deploy.runs.backends import BusCells
from deploy.runs.simulation import Simulation
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions, plan
from deploy.workers.system import System
from deploy.workers.worker import WorkerConfig, serve
from plant.tick import TickHooks
from tests.tools import marked_program

ROOT: Final = Path(__file__).resolve().parents[2]
OURS: Final = ("bus", "cell_firmware", "plant", "deploy")
LIMITS: Final = {"message": 11, "drive": 15, "fault": 15}
"""Most files from end to end."""
_DEPTH: Final = 6
_MANY: Final = 256
"""Items of a container that are looked at."""

# --- marks ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mark:
    """Numbers that no other value of a run has, and what they look like in text and bytes."""

    numbers: tuple[float, ...]

    @property
    def texts(self) -> tuple[str, ...]:
        return tuple(map(repr, self.numbers))

    @property
    def patterns(self) -> tuple[bytes, ...]:
        packed = (struct.pack(form, n) for n in self.numbers if isinstance(n, float) for form in ("<d", ">d"))
        return (*packed, *(text.encode() for text in self.texts))

    def in_bytes(self, data: bytes) -> bool:
        return any(pattern in data for pattern in self.patterns)

    def is_in(self, value: object, depth: int = _DEPTH) -> bool:
        """Whether a value contains a mark; objects are looked into if they are records."""
        if isinstance(value, (bool, type(None))):
            return False
        if isinstance(value, (int, float)):
            return value in self.numbers
        if isinstance(value, str):
            return any(text in value for text in self.texts)
        if isinstance(value, (bytes, bytearray)):
            return self.in_bytes(bytes(value))
        if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
            return self.in_bytes(value.tobytes())
        return depth > 0 and any(self.is_in(part, depth - 1) for part in parts(value))


def parts(value: object) -> Iterator[object]:
    """Items of containers and fields of records; of other objects nothing."""
    if isinstance(value, Mapping):
        items: Iterable[object] = (part for pair in list(value.items())[:_MANY] for part in pair)
    elif isinstance(value, (list, tuple, set, frozenset, deque)):
        items = list(value)[:_MANY]
    elif isinstance(value, np.ndarray):
        items = value.ravel()[:_MANY]
    elif isinstance(value, BaseModel):
        items = list(vars(value).values())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = [getattr(value, one.name, None) for one in dataclasses.fields(value)]
    else:
        return
    yield from items


# --- the trace ------------------------------------------------------------------------------------

Place = tuple[str, str, str]
"""File, function, and ``call`` or ``return``."""


@dataclass
class Route:
    """Way of one marked item.

    Attributes:
        name: What it is.
        mark: Its mark.
        ends: The path in a thread is over with the first such event in which the mark appears.
        ends_anyway: It is over with the first such event, once the mark has appeared in the thread.
        threads: The threads on the way, in order.
        paths: By thread, the files with the function in which the mark appeared first.
        over: Threads whose paths are over.
        calls_up: Files of ``deploy`` that a file of a lower package has called with the mark.
    """

    name: str
    mark: Mark
    ends: Collection[Place]
    ends_anyway: Collection[Place] = ()
    threads: tuple[str, ...] = ()
    paths: dict[str, list[tuple[str, str]]] = field(default_factory=dict[str, list[tuple[str, str]]])
    over: set[str] = field(default_factory=set[str])
    calls_up: list[str] = field(default_factory=list[str])

    @property
    def limit(self) -> int:
        """Most files."""
        return LIMITS[self.name.partition(" ")[0]]

    @property
    def files(self) -> list[str]:
        """Files on the way, each once."""
        return list(dict.fromkeys(file for thread in self.threads for file, _ in self.paths.get(thread, ())))

    @property
    def climbs(self) -> list[str]:
        """Files of ``deploy`` that a lower package calls, or that a thread enters after plant or cells."""
        found = list(self.calls_up)
        for path in self.paths.values():
            files = [file for file, _ in path]
            lower = [i for i, file in enumerate(files) if file.startswith(("cell_firmware/", "plant/"))]
            found += [file for file in files[lower[0] :] if file.startswith("deploy/")] if lower else []
        return found

    def see(self, thread: str, frame: FrameType, event: str, result: object) -> None:
        file = file_of(frame)
        if file is None or thread in self.over:
            return
        place = (file, frame.f_code.co_name, event)
        seen = self.mark.is_in(frame.f_locals) or self.mark.is_in(result)
        if seen:
            self._add(thread, frame)
            caller = caller_of(frame)
            if event == "call" and caller and file.startswith("deploy/") and not caller.startswith("deploy/"):
                self.calls_up.append(file)
        if (seen and place in self.ends) or (place in self.ends_anyway and thread in self.paths):
            self.over.add(thread)

    def _add(self, thread: str, frame: FrameType) -> None:
        """Add the file of a frame that has the mark, after those of its callers that have it."""
        stack: list[FrameType] = []
        caller: FrameType | None = frame
        while caller is not None:
            stack.append(caller)
            caller = caller.f_back
        path = self.paths.setdefault(thread, [])
        for one in reversed(stack):
            file = file_of(one)
            if file is None or file.partition("/")[0] not in OURS or file in [known for known, _ in path]:
                continue
            if one is frame or self.mark.is_in(one.f_locals):
                path.append((file, one.f_code.co_qualname.partition(".<locals>")[0]))


def file_of(frame: FrameType) -> str | None:
    """File of a frame's code, from the root of the project; None for others' code, in an environment below it too."""
    path = frame.f_code.co_filename
    file = path[len(str(ROOT)) + 1 :] if path.startswith(f"{ROOT}/") else ""
    return file if file.partition("/")[0] in (*OURS, "tests") else None


def caller_of(frame: FrameType) -> str | None:
    """File of the nearest caller whose code is ours; None if there is none."""
    caller = frame.f_back
    while caller is not None:
        file = file_of(caller)
        if file is not None and file.partition("/")[0] in OURS:
            return file
        caller = caller.f_back
    return None


class Tracer:
    """Profile function of all threads, which watches routes while it is on."""

    def __init__(self, *routes: Route) -> None:
        self.routes = routes
        self.on = False

    def __call__(self, frame: FrameType, event: str, result: object) -> None:
        if self.on and event in ("call", "return"):
            thread = threading.current_thread().name
            for route in self.routes:
                route.see(thread, frame, event, result)

    @contextmanager
    def installed(self) -> Iterator[None]:
        before, others = sys.getprofile(), threading.getprofile()
        threading.setprofile(self)
        sys.setprofile(self)
        try:
            yield
        finally:
            sys.setprofile(before)
            threading.setprofile(others)


# --- the system -----------------------------------------------------------------------------------

PLANT, SENDER, RECEIVER = "MainThread", "cells 0", "cells 1"
THREADS: Final = {PLANT: "plant", SENDER: "cell", RECEIVER: "neighbour"}
PERIOD_S: Final = 0.015625


class Cells:
    """Group of agents, one thread a shard: what a worker process runs, in threads."""

    def __init__(self, endpoints: list[MemoryEndpoint]) -> None:
        self._endpoints = endpoints
        self._threads: list[threading.Thread] = []
        self._ended = threading.Event()

    def start(self, order: WorkerConfig) -> None:
        for shard, endpoint in enumerate(self._endpoints):
            thread = threading.Thread(
                target=self._serve, args=(order, shard, endpoint), name=f"cells {shard}"
            )
            self._threads.append(thread)
            thread.start()

    def _serve(self, order: WorkerConfig, shard: int, endpoint: MemoryEndpoint) -> None:
        try:
            serve(order, shard, endpoint)
        finally:
            self._ended.set()

    def ended(self, shard: int) -> bool:
        return not self._threads[shard].is_alive()

    def trouble(self, timeout_s: float) -> bool:
        return self._ended.wait(timeout_s)

    def programs_failed(self) -> bool:
        return False

    def check(self) -> None:
        assert not self._ended.is_set(), "an agent ended early"

    def details(self) -> str:
        return ""

    def close(self, grace_s: float) -> None:
        for thread in self._threads:
            thread.join(max(grace_s, 5.0))
            assert not thread.is_alive()
        for endpoint in self._endpoints:
            endpoint.close()


def trace(tracer: Tracer, program: str, wire: WireFormat, request: Mapping[str, Any] | None) -> list[Any]:
    """Run a few ticks, with the trace on for two of them; return the answers to the request.

    Args:
        tracer: Watches the routes.
        program: Class of the program.
        wire: Wire format.
        request: Request to the control server, for the first traced tick; None: no request.
    """
    scene = load_scene(
        {
            "duration_s": 1.0,
            "array": {"rows": 1, "columns": 2},
            "cells": {"firmware": f"{marked_program.__name__}:{program}", "period_s": PERIOD_S},
            "parcels": [],
            "friction": {"law": "viscous", "coefficient_s_per_m": 0.2},
        }
    )
    options = RunOptions(processes=0, transport="memory", wire=wire)
    both = dataclasses.replace(plan(scene, options, "trace"), partition=Partition.even(scene.lattice(), 2))
    requests: deque[bytes] = deque()
    answers: list[Any] = []
    with tracer.installed(), System(both, scene, options, live=True) as system:
        system.open()
        assert isinstance(system._endpoint, MemoryEndpoint)
        assert system._cells is not None
        system._cells.close(0.0)
        bus = system._endpoint._bus
        system._cells = Cells([bus.endpoint() for _ in range(2)])
        backend = BusCells(system, metered=True)
        with Simulation.open(scene, backend) as simulation:
            assert system.coordinator is not None
            server = ControlServer(
                scene,
                "trace",
                (),
                system.coordinator.control,
                SimpleNamespace(inject=_ignore, control=_ignore),  # pyright: ignore[reportArgumentType] - no log
                simulation.process,
                _Queue(requests, answers),  # pyright: ignore[reportArgumentType] - needs no session
            )
            simulation.add_hooks(TickHooks(before_tick=(server.before_tick,)))
            while simulation.tick < marked_program.TICK:
                assert simulation.step() is not None
            if request is not None:
                requests.append(json.dumps(request).encode())
            tracer.on = True
            for _ in range(2):
                assert simulation.step() is not None
            tracer.on = False
    return answers


def _ignore(one: object) -> None:
    del one


@dataclass
class _Queue:
    waiting: deque[bytes]
    answers: list[Any]

    def drain(self) -> Any:
        if not self.waiting:
            return None
        return SimpleNamespace(
            payload=self.waiting.popleft(), answer=lambda text: self.answers.append(json.loads(text))
        )


# --- what is traced -------------------------------------------------------------------------------

SENT: Final = ("bus/transports/memory.py", "put", "return")
"""A payload was handed to the transport."""
READ: Final = ("tests/tools/marked_program.py", "step", "call")
"""The neighbour's program has its inputs."""
COMMANDED: Final = ("plant/wheels.py", "command", "call")
"""The wheels have the drives."""
STEPPED: Final = ("cell_firmware/shard.py", "step", "return")
"""The cells have been stepped with the fault."""

PROGRAMS: Final = ("Plain", "OnArrays")
WIRES: Final[tuple[WireFormat, ...]] = ("packed", "per_cell")


def message_and_drive(program: str = "Plain", wire: WireFormat = "packed") -> tuple[Route, Route]:
    """Trace a message and a drive."""
    message = Route("message", Mark((marked_program.VALUE,)), {SENT, READ}, threads=(SENDER, RECEIVER))
    drive = Route("drive", Mark((marked_program.SPEED_M_S,)), {SENT, COMMANDED}, threads=(SENDER, PLANT))
    trace(Tracer(message, drive), program, wire, None)
    return message, drive


CORNER: Final = 864_209_753
END: Final = 482_042_107
FOR_S: Final = END * PERIOD_S
NUMBER: Final = 0.2718281828459045
TARGET: Final = {"rectangle": [[0, 0], [CORNER, CORNER]]}
FAULTS: Final[dict[str, dict[str, Any]]] = {
    "crash": TARGET,
    "hang": TARGET,
    "reboot": TARGET,
    "slow_clock": {**TARGET, "factor": 0.5},
    "remove": TARGET,
    "wheel_stuck": TARGET,
    "wheel_weak": {**TARGET, "strength": NUMBER},
    "wheel_reversed": TARGET,
    "wheel_runaway": {**TARGET, "speed_m_s": NUMBER},
    "sensor_stuck": {**TARGET, "value": 1},
    "sensor_flip": {**TARGET, "rate": NUMBER},
    "sensor_delay": {**TARGET, "ticks": 2},
    "link_down": TARGET,
    "link_loss": {**TARGET, "probability": NUMBER},
    "link_delay": {**TARGET, "ticks": 2},
    "link_duplicate": {**TARGET, "probability": NUMBER},
    "link_reorder": {**TARGET, "probability": NUMBER},
    "link_corrupt": {**TARGET, "probability": NUMBER},
    "link_bandwidth": {**TARGET, "messages_per_s": 50.0},
    "babble": TARGET,
    "lie": {**TARGET, "mode": "offset", "by": 0.5},
    "partition": {"column": 0},
}
"""By kind, a fault that strikes both cells; its corner, its duration and its number, if it has one, are marked.

A lie's number is not: it would mark the messages that the fault has changed.
"""


def live_fault(kind: str) -> Route:
    """Trace a fault injected at run time, from the control server to the cells or, of wheels, to the wheels."""
    request: dict[str, Any] = {"op": "inject", "fault": {"kind": kind, **FAULTS[kind]}}
    numbers: tuple[float, ...] = (CORNER, NUMBER)
    if KINDS[kind].repairable:
        request["for_s"] = FOR_S
        numbers += FOR_S, marked_program.TICK + END
    in_cells = issubclass(KINDS[kind], CellFault)
    route = Route(
        f"fault {kind}",
        Mark(numbers),
        {SENT} if in_cells else (),
        (STEPPED,) if in_cells else (COMMANDED,),
        threads=(PLANT, SENDER) if in_cells else (PLANT,),
    )
    (answer,) = trace(Tracer(route), "Plain", "packed", request)
    assert answer["ok"], answer
    return route


def shown() -> list[Route]:
    """Routes that are printed: of the faults, one that every cell's program meets and one of the wheels."""
    return [*message_and_drive(), live_fault("hang"), live_fault("wheel_runaway")]


def as_text(route: Route) -> str:
    """Render a route as numbered lines; a file that a second thread passes again keeps its number."""
    number = {file: i for i, file in enumerate(route.files, start=1)}
    lines = [f"{route.name}: {len(number)} files, at most {route.limit}"]
    for thread in route.threads:
        lines.append(f"  {THREADS[thread]}")
        lines += [f"    {number[file]:2} {file}: {function}" for file, function in route.paths[thread]]
    return "\n".join(lines)


def main() -> None:
    """Print the routes."""
    parser = argparse.ArgumentParser(description="Files that a message, a drive and live faults pass.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    as_json = parser.parse_args().json
    routes = shown()
    if as_json:
        found = [
            {
                "name": route.name,
                "limit": route.limit,
                "files": len(route.files),
                "paths": {THREADS[thread]: route.paths[thread] for thread in route.threads},
            }
            for route in routes
        ]
        sys.stdout.write(f"{json.dumps(found, indent=2)}\n")
    else:
        sys.stdout.write("\n\n".join(map(as_text, routes)) + "\n")


if __name__ == "__main__":
    main()
