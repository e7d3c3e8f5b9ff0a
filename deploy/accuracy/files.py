"""What a study of accuracy leaves in a folder: its report as JSON and CSV, and the pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deploy.files import write_text

if TYPE_CHECKING:
    from deploy.accuracy.report import Report

JSON_NAME = "accuracy.json"
CSV_NAME = "accuracy.csv"
WORK_PRECISION = "work_precision.png"
TOLERANCE = "tolerance.png"
SAMPLING = "sampling.png"


def write_report(report: Report, folder: Path) -> None:
    """Write all files, each whole or not at all.

    Raises:
        DeployError: One can't be written.
    """
    from deploy.accuracy.pictures import draw_sampling, draw_tolerance, draw_work_precision

    write_text(folder / JSON_NAME, report.to_json() + "\n")
    write_text(folder / CSV_NAME, report.to_csv())
    draw_work_precision(report, folder / WORK_PRECISION)
    draw_tolerance(report, folder / TOLERANCE)
    if report.sampling:
        draw_sampling(report, folder / SAMPLING)
