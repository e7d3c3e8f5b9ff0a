"""Errors of firmware: one root class, and subclasses that callers distinguish."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar


class FirmwareError(Exception):
    """Root of all errors of this package."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One invalid value: where, which rule, and what was given."""

    path: tuple[str | int, ...]
    message: str
    value: Any = None

    def __str__(self) -> str:
        return f"{dotted(self.path)}: {self.message}" if self.path else self.message


class ParametersError(FirmwareError):
    """Parameters refused by the firmware, with all problems at once.

    Attributes:
        firmware: Name of the firmware as requested.
        problems: Every problem; paths start inside the parameters.
    """

    def __init__(self, firmware: str, problems: tuple[Problem, ...]) -> None:
        super().__init__(firmware, problems)
        self.firmware = firmware
        self.problems = problems

    def __str__(self) -> str:
        return "\n".join(f"parameters of {self.firmware}: {problem}" for problem in self.problems)


class SettingError(FirmwareError):
    """A setting of the cells' board that does not go with the others.

    Attributes:
        path: From the top of the scene.
        value: What is there.
        rule: That it breaks.
    """

    def __init__(self, path: tuple[str | int, ...], value: Any, rule: str) -> None:
        super().__init__(path, value, rule)
        self.path = path
        self.value = value
        self.rule = rule

    def __str__(self) -> str:
        return f"{dotted(self.path)} = {self.value}: {self.rule}"


class MessageValueError(FirmwareError):
    """A value that a message's field can't carry: not a number, out of its type's range, or not finite."""


class FirmwareFailed(FirmwareError):
    """A cell's firmware raised, or returned something that no drive or link can take.

    Attributes:
        cell: ``(row, column)``.
        tick: The tick whose step failed.
        problem: One line: what happened.
        trace: The traceback, or an empty string where nothing was raised.
    """

    def __init__(self, cell: tuple[int, int], tick: int, problem: str, trace: str = "") -> None:
        super().__init__(cell, tick, problem, trace)
        self.cell = cell
        self.tick = tick
        self.problem = problem
        self.trace = trace

    def __str__(self) -> str:
        line = f"firmware of cell {self.cell[0]},{self.cell[1]} failed in tick {self.tick}: {self.problem}"
        return f"{line}\n{self.trace}" if self.trace else line


class NeverReturned(BaseException):
    """A program was interrupted because it had not returned for too long.

    No Exception, so that a program that catches its own errors doesn't catch this one. Raised by a watching thread
    in the program's own, where it can be raised by its class alone: a run derives one that says how long is too long.
    """

    problem: ClassVar[str] = "the program did not return"

    def __str__(self) -> str:
        return self.problem


def dotted(path: tuple[str | int, ...]) -> str:
    """``("held", 0, "cell")`` as ``held[0].cell``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else part
    return text
