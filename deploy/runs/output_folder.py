"""Output folder of a run: made, locked, and cleared of the results of the run before."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from deploy.checkpoints.store import CheckpointStore
from deploy.errors import InputError
from deploy.plots.kinds import KINDS
from deploy.plots.overview import FILE_NAME as PICTURE
from deploy.protocol_report.report import CSV as PROTOCOL_CSV
from deploy.protocol_report.report import PICTURE as PROTOCOL_PICTURE
from deploy.recordings.exports.names import FILES as EXPORTS
from deploy.runs.output import run_name
from deploy.util.files import SUMMARY
from deploy.util.output_lock import locked_folder, new_folder

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene


@contextmanager
def output_folder(scene: Scene, wanted: Path | None, warn: Callable[[str], None]) -> Generator[Path]:
    """Make the output folder of a run, locked inside the context.

    Results of an earlier run are removed: after an interruption they could be mistaken for this run's.

    Args:
        scene: Gives the default its name: ``runs/SCENE-YYYYmmdd-HHMMSS``, numbered where that exists.
        wanted: The requested folder; may exist.
        warn: Told, in one line, that the folder can't be locked.

    Raises:
        InputError: The folder can't be made or written to, or another process writes there.
    """
    folder = new_folder(run_name(scene, time.strftime("%Y%m%d-%H%M%S"))) if wanted is None else wanted
    with locked_folder(folder, warn):
        # The checkpoints go first: whenever this is cut short, those that are left have their recording.
        CheckpointStore(folder).clear()
        remove_results(folder)
        yield folder


def remove_results(folder: Path) -> None:
    """Remove the results of an earlier run, and plots and exports of these, except its recording and checkpoints.

    Raises:
        InputError: A file can't be removed.
    """
    plots = (f"{kind}.png" for kind in KINDS)
    for name in (SUMMARY, PICTURE, PROTOCOL_CSV, PROTOCOL_PICTURE, *plots, *EXPORTS):
        _remove(folder, name)
    for draft in folder.glob(".*.draft"):  # of a process that was killed while it wrote
        with suppress(OSError):
            draft.unlink()


def _remove(folder: Path, name: str) -> None:
    try:
        (folder / name).unlink()
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise InputError(f"output {folder}: can't replace {name} there: {error.strerror or error}") from None
