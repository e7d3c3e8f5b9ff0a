"""Execution of ``run`` and ``simulate``: printed summary and exit status."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

import typer

from deploy.util.signals import Interrupted, Interruption

if TYPE_CHECKING:
    from deploy.runs.summary import Outcome

EXIT_STATUS = {"ok": 0, "failed": 1, "stalled": 1, "unstable": 3, "interrupted": 130}


def execute(what: str, work: Callable[[Interruption], Outcome], *, as_json: bool) -> NoReturn:
    """Do the work while signals are watched for, report what it came to, and end the command.

    Args:
        what: Names the work where a signal comes before it has begun.
        work: Heeds the interruption it is given.
        as_json: Whether to report for programs.
    """
    interruption = Interruption()
    with interruption.handling(last=True):
        try:
            # What a firmware prints in this process is no part of what the command prints.
            with contextlib.redirect_stdout(sys.stderr):
                outcome = work(interruption)
        except Interrupted as interrupted:
            sys.stderr.write(f"mdms: interrupted before {what} began\n")
            raise typer.Exit(interrupted.exit_code) from None
        raise typer.Exit(report(outcome, as_json=as_json))


def report(outcome: Outcome, *, as_json: bool) -> int:
    """Print the outcome; errors go to stderr, with error and place in the last line.

    Returns:
        The exit status.
    """
    summary = outcome.summary
    if as_json:
        print(summary.to_json())
    else:
        from rich.console import Console

        from deploy.runs.summary_table import print_summary

        print_summary(summary, Console())
    sys.stdout.flush()
    if outcome.detail:
        sys.stderr.write(f"{outcome.detail.rstrip()}\n")
    if summary.status != "ok":
        reason = summary.reason or "no reason is known: this is a bug"
        if not reason.startswith(f"{summary.status} "):  # "interrupted at 3 s" says it
            reason = f"{summary.status}: {reason}"
        sys.stderr.write(f"mdms: {reason}\n")
    return EXIT_STATUS[summary.status]
