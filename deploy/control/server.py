"""What is asked of a run while it goes on, and what was asked of it when it was recorded: carried out tick by tick."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol, cast, final

from bus.fault import FaultSpec, Injected
from bus.lattice import NEVER
from bus.wire.frames import TEXT_LIMIT, Control
from cell_firmware.faults.base import CellFault
from deploy.control.protocol import heard, told
from deploy.control.requests import (
    InjectRequest,
    ListRequest,
    RepairRequest,
    Request,
    RequestError,
    read_request,
)
from deploy.scenes.fault_schedule import is_death
from plant.faults.base import PlantFault

if TYPE_CHECKING:
    from bus.transports.zenoh.requests import Questions
    from deploy.recordings.run_log import Ledger
    from deploy.scenes.scene import Scene

_A_TICK: Final = 8
"""Questions that are answered before a tick; the others wait for the next."""

Record = Mapping[str, Any]


class Process(Protocol):
    """What the console needs of ``plant.process.PlantProcess``."""

    def inject(self, fault: Injected[PlantFault]) -> None:
        """One more fault of the plant's parts."""
        ...

    def replan(self) -> None:
        """The end of a fault has changed."""
        ...


@final
class Console:
    """Takes requests between two ticks; each acts from the next tick on, is answered and recorded.

    Args:
        scene: What runs.
        run: Its name.
        faults: Those that the scene schedules.
        tell: Tells all cells.
        ledger: Where faults and requests are noted.
        questions: Where requests come in; None: nowhere.
        script: Records of requests to be repeated, by their ticks.
        lines: Whether serial lines can be disturbed: they carry bytes, and not whole messages.
    """

    def __init__(
        self,
        scene: Scene,
        run: str,
        faults: Sequence[Injected[FaultSpec]],
        tell: Callable[[Control], None],
        ledger: Ledger,
        questions: Questions | None = None,
        script: Sequence[Record] = (),
        *,
        lines: bool = True,
    ) -> None:
        self._scene = scene
        self._lattice = scene.lattice()
        self._run = run
        self._faults = {one.number: one for one in faults}
        self._tell = tell
        self._ledger = ledger
        self._questions = questions
        self._script = sorted(script, key=lambda record: int(record["tick"]))
        self._deaf = scene.effects.serial is not None and not lines
        self._repaired: set[int] = set()
        self._process: Process | None = None

    def attach(self, process: Process) -> None:
        """The plant's process, which calls ``attend``."""
        self._process = process

    def attend(self, tick: int) -> None:
        """Carry out what is to act from ``tick`` on, which is the next."""
        while self._script and self._script[0]["tick"] <= tick:
            self._repeat(self._script.pop(0), tick)
        if self._questions is None:
            return
        for _ in range(_A_TICK):
            question = self._questions.take()
            if question is None:
                return
            try:
                answer = self._carry_out(read_request(question.payload), tick)
            except RequestError as error:
                answer = {"ok": False, "problems": error.problems}
            question.answer(json.dumps({"run": self._run, **answer}).encode())

    def retell(self, cells: Sequence[int], tick: int) -> None:
        """Tell cells that come anew, from ``tick`` on, what has been done to the run so far."""
        names = tuple(self._lattice.cells[cell] for cell in cells)
        for one in self._faults.values():
            if one.live and isinstance(one.fault, CellFault):
                self._tell(Control("fault", tick, names, _text(one)))
        for number in self._repaired:
            end = self._faults[number].end
            self._tell(Control("fault", tick, names, json.dumps({"number": number, "end": end})))

    # --- what is asked ----------------------------------------------------------------------------

    def _carry_out(self, request: Request, tick: int) -> dict[str, Any]:
        time = {"tick": tick, "time_s": tick * self._scene.tick_ns * 1e-9}
        match request:
            case InjectRequest():
                one = self._new(request, tick)
                self._inject(one)
                cells = [list(self._lattice.cells[int(i)]) for i in one.cells[:64]]
                return {"ok": True, **time, "number": one.number, "cells": cells, "struck": len(one.cells)}
            case RepairRequest():
                self._repair(request.number, tick)
                return {"ok": True, **time, "number": request.number}
            case ListRequest():
                return {
                    "ok": True,
                    **time,
                    "faults": [self._listed(one, tick) for one in self._faults.values()],
                }

    def _new(self, request: InjectRequest, tick: int) -> Injected[FaultSpec]:
        fault = cast("FaultSpec", request.fault)
        problems = [
            f"fault.{'.'.join(map(str, path))}: {rule}" for path, _, rule in fault.misplaced(self._lattice)
        ]
        if isinstance(fault, PlantFault):
            effects = self._scene.effects
            problems += [
                f"fault.{'.'.join(map(str, path))}: {rule}" for path, _, rule in fault.at_odds(effects)
            ]
        if fault.at_s:
            problems.append("fault.at_s: a live fault begins now: leave it out")
        if request.for_s is not None and not fault.lasts:
            problems.append(f"for_s: {fault.called} happens once: leave it out")
        if request.for_s is not None and fault.until_s is not None:
            problems.append("for_s: fault.until_s says it already")
        if isinstance(fault, CellFault) and self._deaf:
            problems.append(
                "fault.kind: this run's serial lines carry whole messages, as nothing was to happen to them: run it "
                "with --realtime, or schedule the fault in the scene"
            )
        end = self._end(fault, request.for_s, tick)
        if end <= tick:
            problems.append("fault.until_s: is over already")
        if problems:
            raise RequestError(*problems)
        number = max(self._faults, default=-1) + 1
        struck = fault.struck(self._lattice, self._scene.seed, number)
        one = Injected(number, fault, struck, tick, end, live=True)
        if len(_text(one)) > TEXT_LIMIT:
            raise RequestError("fault.cells: are too many to be told at once: use rectangle or share")
        return one

    def _end(self, fault: FaultSpec, for_s: float | None, tick: int) -> int:
        """The tick from which a fault that begins at ``tick`` doesn't act any more."""

        def from_now(span_s: float) -> int:
            return tick + self._scene.tick_at(span_s)

        if for_s is not None:
            return from_now(for_s)
        return fault.span(from_now)[1] if fault.until_s is None else self._scene.tick_at(fault.until_s)

    def _listed(self, one: Injected[FaultSpec], tick: int) -> dict[str, Any]:
        state = "acts" if one.acts(tick) else "is to come" if tick < one.first else "is over"
        return {
            "number": one.number,
            "kind": one.fault.called,
            "struck": len(one.cells),
            "from_tick": one.first,
            "until_tick": None if one.end == NEVER else one.end,
            "state": state,
        }

    # --- what is done -----------------------------------------------------------------------------

    def _inject(self, one: Injected[FaultSpec]) -> None:
        self._faults[one.number] = one
        if isinstance(one.fault, CellFault):
            self._tell(Control("fault", one.first, (), _text(one)))
        if isinstance(one.fault, PlantFault):
            assert self._process is not None, "this is a bug: a console without a process"
            self._process.inject(cast("Injected[PlantFault]", one))
        self._ledger.inject(one)
        self._ledger.control(
            {
                "time_s": one.first * self._scene.tick_ns * 1e-9,
                "kind": "fault",
                "tick": one.first,
                "detail": told(one),
            }
        )

    def _repair(self, number: int, tick: int) -> None:
        one = self._faults.get(number)
        if one is None:
            known = ", ".join(map(str, sorted(self._faults))) or "none"
            raise RequestError(f"number: there is no fault {number}; there are: {known}")
        if is_death(one):
            raise RequestError(f"number: the cells of fault {number} have left the run for good")
        if not one.fault.lasts or not one.acts(tick):
            raise RequestError(f"number: fault {number} doesn't act now")
        one.end = tick
        assert self._process is not None, "this is a bug: a console without a process"
        self._repaired.add(number)
        self._process.replan()
        self._ledger.replan()
        detail = {"number": number, "end": tick}
        self._tell(Control("fault", tick, (), json.dumps(detail)))
        time_s = tick * self._scene.tick_ns * 1e-9
        self._ledger.control({"time_s": time_s, "kind": "repair", "tick": tick, "detail": detail})

    # --- what is repeated -------------------------------------------------------------------------

    def _repeat(self, record: Record, tick: int) -> None:
        """Do what a recording says was done."""
        detail: dict[str, Any] = record["detail"]
        if record["kind"] == "repair":
            self._repair(int(detail["number"]), tick)
        else:
            self._inject(heard(detail, self._scene))


def _text(one: Injected[FaultSpec]) -> str:
    return json.dumps(told(one))
