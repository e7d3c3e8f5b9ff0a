"""Checks of a program of cells, each with a verdict."""

from __future__ import annotations

import copy
import json
import os
import subprocess
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.wire.message_type import leaves
from cell_firmware.cell import CellInputs, PerCellAdapter
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Firmware, Inputs, State
from cell_firmware.loader import load
from cell_firmware.scalar_program import PYTHON, ScalarProgram
from cell_firmware.specs import CellsSpec
from deploy.errors import InputError
from deploy.studies.firmware.purity import changed, outside_values, same, watching_calls
from deploy.studies.firmware.setting import setting_of
from deploy.studies.firmware.trial import Trace, run_trial
from deploy.util.own_python import module_command

_POISON = 0x5A


@final
@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict of a check.

    Attributes:
        check: Name of the check.
        verdict: ``ok``, ``failed``, or ``skipped``.
        detail: What was found, or why the check was skipped.
    """

    check: str
    verdict: str
    detail: str


@final
class FirmwareCheck:
    """Checks of one program.

    Args:
        spec: Program, parameters and control period.
        others: Other forms of the program, which must do the same, by name.
        lattice: The cells.
        ticks: Number of ticks of a trial.
        seed: Seed of readings, losses of messages, and the program's random numbers.

    Attributes:
        firmware: The program.

    Raises:
        FirmwareError: The program or another form can't be loaded.
        InputError: Its ``init`` failed, or a form has other messages.
    """

    def __init__(
        self, spec: CellsSpec, others: Mapping[str, CellsSpec], lattice: Lattice, ticks: int, seed: int
    ) -> None:
        self._spec, self._lattice = spec, lattice
        self.firmware = load(spec)
        self.firmware.check(lattice)
        self._others = {name: load(other) for name, other in others.items()}
        for name, other in self._others.items():
            if other.message != self.firmware.message:
                raise InputError(f"{name}: its messages are {other.message}, and not {self.firmware.message}")
        self._setting = setting_of(self.firmware, spec, lattice, ticks, seed)
        try:
            self._trace = run_trial(self.firmware, self._setting)
        except FirmwareFailed as error:
            raise InputError(f"{spec.firmware}: {error}") from error

    def verdicts(self) -> Iterator[Verdict]:
        """Yield the verdict of each check."""
        yield self._runs()
        yield self._repeats()
        yield self._one_and_many()
        yield from self._forms()
        yield self._arguments()
        yield self._ranges()
        yield self._pure()

    def _fresh(self) -> Firmware:
        return load(self._spec)

    def _differs(self, other: Trace, ours: str, theirs: str) -> str | None:
        return self._trace.difference(other, self._lattice.cells, (ours, theirs))

    def _runs(self) -> Verdict:
        failures, setting = self._trace.failures, self._setting
        if failures:
            return Verdict("runs", "failed", str(failures[0]))
        return Verdict("runs", "ok", f"no failure of {len(setting.cells)} cells in {setting.ticks} ticks")

    def _repeats(self) -> Verdict:
        found = self._differs(run_trial(self._fresh(), self._setting), "at first", "the second time")
        if found is None:
            found = self._elsewhere()
        return _verdict("repeats", found, "the same twice, and in another process")

    def _elsewhere(self) -> str | None:
        """Return the first tick that differs in another process with other hashes of strings."""
        asked = {
            "cells": self._spec.model_dump(mode="json", include={"firmware", "parameters", "period_s"}),
            "lattice": self._lattice.cells,
            "ticks": self._setting.ticks,
            "seed": self._setting.seed,
        }
        ours = os.environ.get("PYTHONHASHSEED", "")
        done = subprocess.run(
            module_command("deploy.studies.firmware.again"),
            input=json.dumps(asked),
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONHASHSEED": "12345" if ours != "12345" else "54321"},
        )
        if done.returncode:
            return f"another process failed: {done.stderr.strip().splitlines()[-1]}"
        for tick, (one, other) in enumerate(zip(self._trace.digests(), json.loads(done.stdout), strict=True)):
            if one != other:
                return f"tick {tick} differs in another process, in which strings have other hashes"
        return None

    def _one_and_many(self) -> Verdict:
        n = len(self._setting.cells)
        cuts = {"alone": list(np.arange(n)[:, None]), "in groups of three": _groups(n, 3)}
        for name, groups in cuts.items():
            found = self._differs(
                run_trial(self.firmware, self._setting, groups, each=self._fresh), f"among {n} cells", name
            )
            if found is not None:
                return Verdict("one and many", "failed", found)
        return Verdict("one and many", "ok", f"the same alone, in groups of three, and among {n} cells")

    def _forms(self) -> Iterator[Verdict]:
        if isinstance(self.firmware, ScalarProgram):
            with _environment(PYTHON, "1"):
                interpreted = run_trial(self._fresh(), self._setting)
            found = self._differs(interpreted, "compiled", "in Python")
            yield _verdict("forms", found, "the same compiled and in Python")
        for name, other in self._others.items():
            found = self._differs(
                run_trial(other, self._setting), f"here ({self.firmware.form})", f"in {name}"
            )
            yield _verdict("forms", found, f"the same as {name} ({other.form})")
        if not self._others and not isinstance(self.firmware, ScalarProgram):
            yield Verdict("forms", "skipped", "there is one form; --against names another")

    def _arguments(self) -> Verdict:
        firmware, notes = self._fresh(), dict[str, None]()
        _guard_arguments(firmware, notes)
        trace = run_trial(firmware, self._setting)
        if notes:
            return Verdict("arguments", "failed", next(iter(notes)))
        found = self._differs(trace, "at first", "once the inputs of earlier ticks are overwritten")
        found = found and f"the state keeps an input instead of a copy: {found}"
        return _verdict("arguments", found, "inputs and state are neither changed nor kept")

    def _ranges(self) -> Verdict:
        trace, declared = self._trace, self.firmware.value_ranges()
        if trace.message is None or trace.sent is None:
            return Verdict("message ranges", "skipped", "there are no messages")
        sent = trace.message[trace.sent]
        if not len(sent):
            return Verdict("message ranges", "skipped", "no message was sent")
        said: list[str] = []
        for leaf in leaves(sent.dtype):
            name, values = leaf.name, leaf.of(sent)[leaf.used(sent)]
            if not len(values):
                continue
            low, high = values.min().item(), values.max().item()
            text = f"{name} from {low!r} to {high!r}"
            if name in declared:
                least, most = declared[name]
                text += f" within {least:g} to {most:g}"
                if low < least or high > most:
                    return Verdict(
                        "message ranges", "failed", text.replace("within", "outside value_ranges,")
                    )
            said.append(text)
        refused = int(np.count_nonzero(~self.firmware.accepts(sent)))
        if refused:
            return Verdict(
                "message ranges", "failed", f"accepts() refuses {refused} of {len(sent)} sent messages"
            )
        return Verdict("message ranges", "ok", ", ".join(said))

    def _pure(self) -> Verdict:
        with _environment(
            PYTHON, "1" if isinstance(self.firmware, ScalarProgram) else os.environ.get(PYTHON)
        ):
            found = [*self._calls(), *self._outside(), *self._again()]
        return _verdict(
            "purity", "; ".join(found), "no clock, no generator, no value outside the state changes"
        )

    def _calls(self) -> list[str]:
        firmware, calls = self._fresh(), dict[str, str]()

        def watched(step: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any) -> Any:
                with watching_calls(calls):
                    return step(*arguments)

            return call

        _wrap(firmware, watched)
        run_trial(firmware, replace(self._setting, ticks=min(self._setting.ticks, 20)))
        return [f"step {what} ({place})" for what, place in calls.items()]

    def _outside(self) -> list[str]:
        firmware = self._fresh()
        program = _program(firmware)
        snapshots = [outside_values(program)]
        middle, last = self._setting.ticks // 2, self._setting.ticks - 1

        def observe(tick: int, *_: object) -> None:
            if tick in (middle, last):
                snapshots.append(outside_values(program))

        run_trial(firmware, self._setting, observe=observe)
        return [f"steps change {name}" for name in changed(snapshots[0], snapshots[1], snapshots[-1])]

    def _again(self) -> list[str]:
        """Call every step a second time with copies of its arguments."""
        firmware, notes = self._fresh(), dict[str, None]()

        def twice(step: Callable[..., Any]) -> Callable[..., Any]:
            def call(state: Any, inputs: Any) -> Any:
                copied = copy.deepcopy(state)
                first = step(state, copy.deepcopy(inputs))
                if not notes and not same(copy.deepcopy(first), step(copied, inputs)):
                    notes["a step that is called again with equal arguments does something else"] = None
                return first

            return call

        _wrap(firmware, twice)
        run_trial(firmware, replace(self._setting, ticks=min(self._setting.ticks, 20)))
        return list(notes)


def _verdict(check: str, problem: str | None, good: str) -> Verdict:
    return Verdict(check, "failed", problem) if problem else Verdict(check, "ok", good)


def _groups(n: int, size: int) -> list[NDArray[np.int64]]:
    return [np.arange(start, min(start + size, n)) for start in range(0, n, size)]


@contextmanager
def _environment(name: str, value: str | None) -> Generator[None]:
    """Set an environment variable; None: leave it."""
    before = os.environ.get(name)
    if value is not None:
        os.environ[name] = value
    try:
        yield
    finally:
        if value is not None:
            if before is None:
                del os.environ[name]
            else:
                os.environ[name] = before


def _program(firmware: Firmware) -> Any:
    """Return the author's own object."""
    return firmware.firmware if isinstance(firmware, PerCellAdapter) else firmware


def _wrap(firmware: Firmware, wrapper: Callable[[Callable[..., Any]], Callable[..., Any]]) -> None:
    """Put a wrapper around the author's step."""
    program = _program(firmware)
    program.step = wrapper(program.step)


def _guard_arguments(firmware: Firmware, notes: dict[str, None]) -> None:
    """Have steps checked for changed arguments, and the inputs of a tick overwritten in the next one.

    Args:
        firmware: The program.
        notes: Findings; is filled.
    """
    used: list[Any] = []

    def guarded(step: Callable[..., Any]) -> Callable[..., Any]:
        def call(state: Any, inputs: Any) -> Any:
            before = copy.deepcopy(state), copy.deepcopy(inputs)
            result = step(state, inputs)
            if not same(before[1], inputs):
                notes["step changes its inputs: make new values"] = None
            if not same(before[0], state):
                notes["step changes the state that it is given: return a new one"] = None
            used.append(inputs)
            return result

        return call

    _wrap(firmware, guarded)
    whole = firmware.step

    def step(state: State, inputs: Inputs) -> Any:
        for old in used:
            _overwrite(old)
        used.clear()
        return whole(state, inputs)

    cast("Any", firmware).step = step


def _overwrite(inputs: Inputs | CellInputs) -> None:
    """Overwrite what can be overwritten of the inputs of a step that is over."""
    if isinstance(inputs, CellInputs):
        for message in inputs.inbox.values():
            if message is not None:
                cast("dict[str, Any]", message).update(dict.fromkeys(message, _POISON))
        return
    arrays = [inputs.presence, inputs.encoder_m, inputs.level, inputs.label]
    if inputs.inbox is not None:
        arrays += [inputs.inbox.received, inputs.inbox.message]
    for array in arrays:
        if array is not None and array.flags.writeable:
            array.view(np.uint8)[...] = 1 if array.dtype == np.bool_ else _POISON
