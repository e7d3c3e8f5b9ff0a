"""The residuals of a run as a table for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deploy.files import written_whole

if TYPE_CHECKING:
    from deploy.protocol_report.residuals import Residuals


def write_csv(residuals: Residuals, path: Path) -> None:
    """Write a line a tick: of every residual its root mean square and its greatest number; empty where there is none.

    Raises:
        DeployError: It can't be written.
    """
    names = list(residuals.rms)
    columns = [column for name in names for column in (residuals.rms[name], residuals.most[name])]
    with written_whole(path) as draft, draft.open("w", encoding="utf-8") as lines:
        lines.write(
            ",".join(["tick", *(f"{name}_{what}" for name in names for what in ("rms", "max"))]) + "\n"
        )
        for row, tick in enumerate(residuals.tick):
            numbers = (column[row] for column in columns)
            lines.write(",".join([str(tick), *("" if x != x else repr(x) for x in numbers)]) + "\n")
