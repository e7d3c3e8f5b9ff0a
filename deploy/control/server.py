"""Control server of a running simulation: reads and handles requests, and replayed commands, between ticks."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Protocol, cast, final

import numpy as np
from pydantic import Field, ValidationError

from bus.fault import FaultInstance, FaultSpec, tick_at
from bus.lattice import NO_TICK_LIMIT
from bus.spec import Spec
from bus.wire.frames import TEXT_LIMIT, Control
from cell_firmware.faults.base import CellFault
from deploy.control.flow import EndedByOperator, Flow, FlowProcess
from deploy.control.replay import LOSS, decode_command
from deploy.control.requests import (
    FaultRequest,
    InjectRequest,
    ListRequest,
    MoveRequest,
    RepairRequest,
    Request,
    ShowRequest,
    StepRequest,
)
from deploy.errors import RequestError
from deploy.faults.registry import DEFAULT
from deploy.scenes.errors import problems_of
from deploy.scenes.fault_schedule import is_permanent_crash
from plant.errors import PlantError
from plant.faults.base import PlantFault

if TYPE_CHECKING:
    from bus.transports.zenoh.requests import IncomingRequest, RequestQueue
    from deploy.recordings.run_log import RunLog
    from deploy.scenes.scene import Scene
    from plant.wheels import Floats

_A_TICK: Final = 8
"""Most requests handled before a tick; the others wait for the next tick."""

_LONGEST: Final = 65_536
_MOST_PROBLEMS: Final = 20
"""Most problems that an answer lists, which bounds the length of the answer."""

Record = Mapping[str, Any]


class _Envelope(Spec):
    request: Annotated[Request, Field(discriminator="op")]


def read_request(payload: bytes | None) -> Request:
    """Decode and check a request.

    Args:
        payload: JSON; None for a payload that was too long to be received.

    Raises:
        RequestError: The payload is no valid request.
    """
    if payload is None or len(payload) > _LONGEST:
        raise RequestError(f"a request: must be at most {_LONGEST} bytes")
    try:
        data: Any = {"request": _with_kind(json.loads(payload))}
        text = json.dumps(data)
    except (ValueError, RecursionError):
        raise RequestError("a request: must be JSON with a few levels of nesting") from None
    try:
        return _Envelope.model_validate_json(text, strict=True).request
    except ValidationError as error:
        problems = problems_of(error, data, _Envelope)
        listed = [str(problem).removeprefix("request.") for problem in problems[:_MOST_PROBLEMS]]
        if len(problems) > _MOST_PROBLEMS:
            listed.append(f"and {len(problems) - _MOST_PROBLEMS} more")
        raise RequestError(*listed) from None


def _with_kind(request: object) -> object:
    """Return a request whose fault has a kind.

    Raises:
        RequestError: The kind is one that scenes alone may have.
    """
    if not isinstance(request, dict):
        return request
    fields = cast("dict[str, object]", request)
    if not isinstance(fields.get("fault"), dict):
        return fields
    fault = {"kind": DEFAULT, **cast("dict[str, object]", fields["fault"])}
    if fault["kind"] == "add":
        raise RequestError(
            "fault: add is for scenes: inject remove, and repair that fault to plug the cells in again"
        )
    return {**fields, "fault": fault}


class FaultProcess(Protocol):
    """Operations of ``plant.process.PlantProcess`` for faults."""

    def inject(self, fault: FaultInstance[PlantFault]) -> None:
        """Add a fault in the plant."""
        ...

    def replan(self) -> None:
        """Update the fault schedule after a fault's end tick has changed."""
        ...


@final
class LiveFaults:
    """Faults of a run: scheduled by its scene, or injected by operators.

    An injected fault acts from the next tick on, and is recorded.

    Args:
        scene: Scene of the run.
        faults: Faults that the scene schedules.
        send: Sends a control record to cells.
        run_log: Log of the run, which records faults and commands.
        process: Plant's process, which applies faults in the plant.
        lines: Whether serial lines are byte-accurate, so that faults can be injected into cells.
    """

    def __init__(
        self,
        scene: Scene,
        faults: Sequence[FaultInstance[FaultSpec]],
        send: Callable[[Control], None],
        run_log: RunLog,
        process: FaultProcess,
        *,
        lines: bool = True,
    ) -> None:
        self._scene = scene
        self._lattice = scene.lattice()
        self._faults = {one.number: one for one in faults}
        self._send = send
        self._run_log = run_log
        self._deaf = scene.effects.serial is not None and not lines
        self._repaired: set[int] = set()
        self._process = process

    @property
    def known(self) -> tuple[FaultInstance[FaultSpec], ...]:
        """All faults so far."""
        return tuple(self._faults.values())

    def handle(self, request: FaultRequest, tick: int) -> dict[str, Any]:
        """Handle a request before ``tick``; return the fields of the answer.

        Raises:
            RequestError: The fault can't be injected or repaired.
        """
        match request:
            case InjectRequest():
                one = self._new(request, tick)
                self.inject(one)
                cells = [list(self._lattice.cells[int(i)]) for i in one.cells[:64]]
                return {"number": one.number, "cells": cells, "affected": len(one.cells)}
            case RepairRequest():
                self.repair(request.number, tick)
                return {"number": request.number}
            case ListRequest():
                return {"faults": [self._listed(one, tick) for one in self._faults.values()]}

    def active(self, tick: int) -> list[FaultInstance[FaultSpec]]:
        """Return the faults that act in ``tick``."""
        return [one for one in self._faults.values() if one.active_at(tick)]

    def resend_faults(self, cells: Sequence[int], tick: int) -> None:
        """Send all live faults and repairs so far to cells that rejoin at ``tick``."""
        names = tuple(self._lattice.cells[cell] for cell in cells)
        for one in self._faults.values():
            if one.injected_at_runtime and isinstance(one.fault, CellFault):
                self._send(Control("fault", tick, names, json.dumps(one.record())))
        for number in self._repaired:
            end = self._faults[number].end_tick
            self._send(Control("fault", tick, names, json.dumps({"number": number, "end": end})))

    # --- faults and repairs ------------------------------------------------------------------------

    def _new(self, request: InjectRequest, tick: int) -> FaultInstance[FaultSpec]:
        fault = cast("FaultSpec", request.fault)
        problems = [
            f"fault.{'.'.join(map(str, path))}: {rule}" for path, _, rule in fault.problems(self._lattice)
        ]
        if isinstance(fault, PlantFault):
            effects = self._scene.effects
            problems += [
                f"fault.{'.'.join(map(str, path))}: {rule}"
                for path, _, rule in fault.setting_problems(effects)
            ]
        if fault.at_s:
            problems.append("fault.at_s: a live fault begins at the next tick: leave at_s out")
        if request.for_s is not None and not fault.repairable:
            problems.append(f"for_s: {fault.kind_name} happens once: leave for_s out")
        if request.for_s is not None and fault.until_s is not None:
            problems.append("for_s: fault.until_s sets the repair already: leave one of the two out")
        if isinstance(fault, CellFault) and self._deaf:
            problems.append(
                "fault.kind: this run's serial lines are not byte-accurate, since no fault was scheduled: start the "
                "run with --realtime, or schedule the fault in the scene"
            )
        end = self._end(fault, request.for_s, tick)
        if end <= tick:
            problems.append("fault.until_s: is in the past")
        if problems:
            raise RequestError(*problems)
        number = max(self._faults, default=-1) + 1
        affected = fault.affected_cells(self._lattice, self._scene.seed, number)
        one = FaultInstance(number, fault, affected, tick, end, injected_at_runtime=True)
        if len(json.dumps(one.record())) > TEXT_LIMIT:
            raise RequestError("fault.cells: are too many for one request: use rectangle or share")
        return one

    def _end(self, fault: FaultSpec, for_s: float | None, tick: int) -> int:
        """Return the tick from which a fault that begins at ``tick`` is over."""

        def from_now(span_s: float) -> int:
            return tick + tick_at(span_s, tick_ns)

        tick_ns = self._scene.tick_ns

        if for_s is not None:
            return from_now(for_s)
        return fault.tick_range(from_now)[1] if fault.until_s is None else tick_at(fault.until_s, tick_ns)

    def _listed(self, one: FaultInstance[FaultSpec], tick: int) -> dict[str, Any]:
        state = "active" if one.active_at(tick) else "scheduled" if tick < one.start_tick else "ended"
        return {
            "number": one.number,
            "kind": one.fault.kind_name,
            "affected": len(one.cells),
            "from_tick": one.start_tick,
            "until_tick": None if one.end_tick == NO_TICK_LIMIT else one.end_tick,
            "state": state,
        }

    def inject(self, one: FaultInstance[FaultSpec], *, loss: bool = False) -> None:
        """Inject a fault from its first tick on.

        Args:
            one: The fault.
            loss: Whether it stands for cells that were found lost, whose drives in flight still act.
        """
        self._faults[one.number] = one
        if isinstance(one.fault, CellFault):
            self._send(Control("fault", one.start_tick, (), json.dumps(one.record())))
        if isinstance(one.fault, PlantFault):
            later = self._scene.bus.sense_to_drive_ticks if loss else 0
            wheels = replace(one, start_tick=one.start_tick + later) if later else one
            self._process.inject(cast("FaultInstance[PlantFault]", wheels))
        self._run_log.inject(one)
        self._run_log.control(
            {
                "time_s": one.start_tick * self._scene.tick_ns * 1e-9,
                "kind": LOSS if loss else "fault",
                "tick": one.start_tick,
                "detail": one.record(),
            }
        )

    def repair(self, number: int, tick: int) -> None:
        """Repair an active fault at ``tick``.

        Raises:
            RequestError: There is no such fault, or it can't be repaired.
        """
        one = self._faults.get(number)
        if one is None:
            known = ", ".join(map(str, sorted(self._faults))) or "none"
            raise RequestError(f"number: there is no fault {number}; there are: {known}")
        if is_permanent_crash(one):
            raise RequestError(f"number: the cells of fault {number} have left the run and can't be repaired")
        if not one.fault.repairable or not one.active_at(tick):
            raise RequestError(f"number: fault {number} is not active")
        one.end_tick = tick
        self._repaired.add(number)
        self._process.replan()
        self._run_log.replan()
        detail = {"number": number, "end": tick}
        self._send(Control("fault", tick, (), json.dumps(detail)))
        time_s = tick * self._scene.tick_ns * 1e-9
        self._run_log.control({"time_s": time_s, "kind": "repair", "tick": tick, "detail": detail})


class Process(FaultProcess, FlowProcess, Protocol):
    """Operations of ``plant.process.PlantProcess`` that the control server uses."""

    tick: int

    def place_parcel(self, parcel: int, pose: Floats) -> None:
        """Put a parcel at rest elsewhere."""
        ...


@final
class ControlServer:
    """Server of control requests, which are handled between two ticks.

    Each request acts from the next tick on, is answered and recorded.

    Args:
        scene: Scene of the run.
        run: Name of the run.
        faults: Faults that the scene schedules.
        send: Sends a control record to cells.
        run_log: Log of the run, which records faults and commands.
        process: Plant's process, which applies faults in the plant.
        requests: Queue of incoming requests; None: no requests can be sent.
        script: Recorded commands to repeat, each with its tick.
        show: Requests the cells' registers once more.
        lines: Whether serial lines are byte-accurate, so that faults can be injected into cells.
        factor: Simulated seconds per wall second; None: as fast as possible.
        paused: Whether the run begins paused.

    Attributes:
        faults: Faults of the run.
        flow: Flow of the run.
        watch: Called whenever requests are handled; see ``deploy.live.feed``.
    """

    def __init__(
        self,
        scene: Scene,
        run: str,
        faults: Sequence[FaultInstance[FaultSpec]],
        send: Callable[[Control], None],
        run_log: RunLog,
        process: Process,
        requests: RequestQueue | None = None,
        script: Sequence[Record] = (),
        *,
        show: Callable[[], None] | None = None,
        lines: bool = True,
        factor: float | None = None,
        paused: bool = False,
    ) -> None:
        self._scene = scene
        self._tick_ns = scene.tick_ns
        self._run = run
        self._run_log = run_log
        self._process = process
        self._requests = requests
        self._script = sorted(script, key=lambda record: int(record["tick"]))
        self._show = show
        self._awaiting: list[IncomingRequest] = []
        """Requests for steps, answered when the run has paused again."""
        self.faults = LiveFaults(scene, faults, send, run_log, process, lines=lines)
        self.flow = Flow(process, run_log, scene.tick_ns, factor, paused=paused, serve=self._serve)
        self.watch: Callable[[], None] | None = None

    def before_tick(self, tick: int) -> None:
        """Handle the replayed commands and the requests that act from ``tick`` on, which is the next tick.

        Returns when the tick may begin: not while the run is paused.

        Raises:
            EndedByOperator: A request ends the run.
        """
        while self._script and self._script[0]["tick"] <= tick:
            self._repeat(self._script.pop(0), tick)
        self._serve()
        self.flow.before_tick()

    def close(self) -> None:
        """Answer the requests that wait for a pause: the run has ended."""
        for question in self._awaiting:
            self._refuse(question, "the run has ended")
        self._awaiting.clear()

    # --- requests ----------------------------------------------------------------------------------

    def _serve(self) -> None:
        """Handle some of the requests that wait."""
        if self.watch is not None:
            self.watch()
        if self._awaiting and self.flow.paused:
            self._process.report()
            for question in self._awaiting:
                self._answer(question, self.flow.state())
            self._awaiting.clear()
        if self._requests is None:
            return
        for _ in range(_A_TICK):
            question = self._requests.drain()
            if question is None:
                return
            self._take(question)

    def _take(self, question: IncomingRequest) -> None:
        """Handle and answer a request."""
        try:
            request = read_request(question.payload)
            found = self._handle(request)
        except RequestError as error:
            self._refuse(question, *error.problems)
        except EndedByOperator:
            self._answer(question, self.flow.state())
            raise
        else:
            if isinstance(request, StepRequest):
                self._awaiting.append(question)
            else:
                self._answer(question, found)

    def _handle(self, request: Request) -> dict[str, Any]:
        tick = self._process.tick
        match request:
            case InjectRequest() | RepairRequest() | ListRequest():
                return self.faults.handle(request, tick)
            case MoveRequest():
                self._move(request, tick)
            case ShowRequest():
                if self._show is not None:
                    self._show()
            case _:
                self.flow.handle(request, tick)
        return self.flow.state()

    def _answer(self, question: IncomingRequest, found: dict[str, Any]) -> None:
        tick = self._process.tick
        time = {"tick": tick, "time_s": tick * self._tick_ns * 1e-9}
        answer = {"run": self._run, "ok": True, **time, **found}
        question.answer(json.dumps(answer).encode())

    def _refuse(self, question: IncomingRequest, *problems: str) -> None:
        question.answer(json.dumps({"run": self._run, "ok": False, "problems": problems}).encode())

    def _move(self, request: MoveRequest, tick: int) -> None:
        """Put a parcel elsewhere.

        Raises:
            RequestError: The run is not paused, or the parcel can't stand there.
        """
        if not self.flow.paused:
            raise RequestError("move: the run is not paused: pause it first")
        self._place(request.parcel, (request.x_m, request.y_m, request.angle_rad), tick)

    def _place(self, parcel: int, pose: tuple[float, float, float], tick: int) -> None:
        try:
            self._process.place_parcel(parcel, np.array(pose))
        except PlantError as error:
            raise RequestError(f"move: {error}") from None
        detail = {"parcel": parcel, "pose": list(pose)}
        time_s = tick * self._tick_ns * 1e-9
        self._run_log.control({"time_s": time_s, "kind": "move", "tick": tick, "detail": detail})

    # --- replay ------------------------------------------------------------------------------------

    def _repeat(self, record: Record, tick: int) -> None:
        """Repeat a recorded command."""
        detail: dict[str, Any] = record["detail"]
        if record["kind"] == "repair":
            self.faults.repair(int(detail["number"]), tick)
        elif record["kind"] == "move":
            x_m, y_m, angle_rad = map(float, detail["pose"])
            self._place(int(detail["parcel"]), (x_m, y_m, angle_rad), tick)
        else:
            self.faults.inject(decode_command(detail, self._scene), loss=record["kind"] == LOSS)
