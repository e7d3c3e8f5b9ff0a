"""Control server of a running simulation: reads and handles requests, and replayed commands, between ticks."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Protocol, cast, final

from pydantic import Field, ValidationError

from bus.fault import FaultInstance, FaultSpec, tick_at
from bus.lattice import NO_TICK_LIMIT
from bus.spec import Spec
from bus.wire.frames import TEXT_LIMIT, Control
from cell_firmware.faults.base import CellFault
from deploy.control.replay import decode_command
from deploy.errors import RequestError
from deploy.faults.registry import DEFAULT, AnyFault
from deploy.scenes.errors import problems_of
from deploy.scenes.fault_schedule import is_permanent_crash
from plant.faults.base import PlantFault

if TYPE_CHECKING:
    from bus.transports.zenoh.requests import RequestQueue
    from deploy.recordings.run_log import RunLog
    from deploy.scenes.scene import Scene

_A_TICK: Final = 8
"""Most requests handled before a tick; the others wait for the next tick."""

_LONGEST: Final = 65_536
_MOST_PROBLEMS: Final = 20
"""Most problems that an answer lists, which bounds the length of the answer."""

Record = Mapping[str, Any]


class InjectRequest(Spec):
    """Request for a fault from the next tick on."""

    op: Literal["inject"]
    fault: Annotated[AnyFault, Field(discriminator="kind")]
    for_s: Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)] | None = None
    """Simulated time until the repair, s; None: as ``fault.until_s`` says, or no repair."""


class RepairRequest(Spec):
    """Request to repair an active fault at the next tick."""

    op: Literal["repair"]
    number: Annotated[int, Field(ge=0)]


class ListRequest(Spec):
    """Request for the list of faults."""

    op: Literal["list"]


Request = InjectRequest | RepairRequest | ListRequest


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


class Process(Protocol):
    """Operations of ``plant.process.PlantProcess`` that the control server uses."""

    def inject(self, fault: FaultInstance[PlantFault]) -> None:
        """Add a fault in the plant."""
        ...

    def replan(self) -> None:
        """Update the fault schedule after a fault's end tick has changed."""
        ...


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
        lines: Whether serial lines are byte-accurate, so that faults can be injected into cells.
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
        lines: bool = True,
    ) -> None:
        self._scene = scene
        self._lattice = scene.lattice()
        self._run = run
        self._faults = {one.number: one for one in faults}
        self._send = send
        self._run_log = run_log
        self._requests = requests
        self._script = sorted(script, key=lambda record: int(record["tick"]))
        self._deaf = scene.effects.serial is not None and not lines
        self._repaired: set[int] = set()
        self._process = process

    def before_tick(self, tick: int) -> None:
        """Handle the replayed commands and the requests that act from ``tick`` on, which is the next tick."""
        while self._script and self._script[0]["tick"] <= tick:
            self._repeat(self._script.pop(0), tick)
        if self._requests is None:
            return
        for _ in range(_A_TICK):
            question = self._requests.drain()
            if question is None:
                return
            try:
                answer = self._handle(read_request(question.payload), tick)
            except RequestError as error:
                answer = {"ok": False, "problems": error.problems}
            question.answer(json.dumps({"run": self._run, **answer}).encode())

    def resend_faults(self, cells: Sequence[int], tick: int) -> None:
        """Send all live faults and repairs so far to cells that rejoin at ``tick``."""
        names = tuple(self._lattice.cells[cell] for cell in cells)
        for one in self._faults.values():
            if one.injected_at_runtime and isinstance(one.fault, CellFault):
                self._send(Control("fault", tick, names, json.dumps(one.record())))
        for number in self._repaired:
            end = self._faults[number].end_tick
            self._send(Control("fault", tick, names, json.dumps({"number": number, "end": end})))

    # --- requests ----------------------------------------------------------------------------------

    def _handle(self, request: Request, tick: int) -> dict[str, Any]:
        time = {"tick": tick, "time_s": tick * self._scene.tick_ns * 1e-9}
        match request:
            case InjectRequest():
                one = self._new(request, tick)
                self._inject(one)
                cells = [list(self._lattice.cells[int(i)]) for i in one.cells[:64]]
                return {"ok": True, **time, "number": one.number, "cells": cells, "affected": len(one.cells)}
            case RepairRequest():
                self._repair(request.number, tick)
                return {"ok": True, **time, "number": request.number}
            case ListRequest():
                return {
                    "ok": True,
                    **time,
                    "faults": [self._listed(one, tick) for one in self._faults.values()],
                }

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

    # --- faults and repairs ------------------------------------------------------------------------

    def _inject(self, one: FaultInstance[FaultSpec]) -> None:
        self._faults[one.number] = one
        if isinstance(one.fault, CellFault):
            self._send(Control("fault", one.start_tick, (), json.dumps(one.record())))
        if isinstance(one.fault, PlantFault):
            self._process.inject(cast("FaultInstance[PlantFault]", one))
        self._run_log.inject(one)
        self._run_log.control(
            {
                "time_s": one.start_tick * self._scene.tick_ns * 1e-9,
                "kind": "fault",
                "tick": one.start_tick,
                "detail": one.record(),
            }
        )

    def _repair(self, number: int, tick: int) -> None:
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

    # --- replay ------------------------------------------------------------------------------------

    def _repeat(self, record: Record, tick: int) -> None:
        """Repeat a recorded command."""
        detail: dict[str, Any] = record["detail"]
        if record["kind"] == "repair":
            self._repair(int(detail["number"]), tick)
        else:
            self._inject(decode_command(detail, self._scene))
