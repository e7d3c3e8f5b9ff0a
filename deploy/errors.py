"""The errors of a run that a person can act on; one root, with the exit status each leads to."""

from __future__ import annotations


class DeployError(Exception):
    """The run failed: one clear line that says what was attempted and why it could not be done."""

    exit_code: int = 1


class InputError(DeployError):
    """Bad input: nothing was started."""

    exit_code: int = 2
