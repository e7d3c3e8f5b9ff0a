"""Errors that a user can act on, with a common base class and an exit status each."""

from __future__ import annotations


class DeployError(Exception):
    """Failure of a run; the message names the attempt and the cause in one line."""

    exit_code: int = 1


class InputError(DeployError):
    """Bad input; nothing was started."""

    exit_code: int = 2


class RequestError(DeployError):
    """A request that the run refuses.

    Attributes:
        problems: Reasons, one line each.
    """

    def __init__(self, *problems: str) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems
