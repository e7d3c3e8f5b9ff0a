"""What ``run`` and ``simulate`` print at the end, and the exit status that goes with it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deploy.run import Outcome

EXIT_STATUS = {"ok": 0, "failed": 1, "stalled": 1, "unstable": 3, "interrupted": 130}


def report(outcome: Outcome, *, as_json: bool) -> int:
    """Print the outcome; what went wrong goes to stderr, its last line saying what and where.

    Returns:
        The exit status.
    """
    summary = outcome.summary
    if as_json:
        print(summary.to_json())
    else:
        from rich.console import Console

        summary.print_table(Console())
    sys.stdout.flush()
    if outcome.detail:
        sys.stderr.write(f"{outcome.detail.rstrip()}\n")
    if summary.status != "ok":
        sys.stderr.write(f"mdms: {summary.status}: {summary.reason or 'no reason is known: this is a bug'}\n")
    return EXIT_STATUS[summary.status]
