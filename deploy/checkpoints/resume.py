"""Finding what a run can go on from, and refusing what it can't."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from hashlib import sha256
from inspect import getsourcefile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from deploy.checkpoints.checkpoint import Checkpoint
from deploy.checkpoints.store import Store
from deploy.errors import InputError
from deploy.files import SUMMARY, versions
from deploy.processes.plan import RunOptions
from deploy.scene import Scene

if TYPE_CHECKING:
    from deploy.processes.plan import Plan

_ALIKE: Final = ("transport", "wire", "registers", "protocol_report", "respawn", "checkpoint_s")
"""Options that a resumed run has from the run it goes on with; the number of processes as the plan has it."""
_OVER: Final = ("ok", "unstable")
"""Ends that going on from a checkpoint could only come to again."""


def found(folder: Path) -> Checkpoint:
    """The checkpoint that a run in a folder can go on from.

    Raises:
        InputError: There is none, or the run is over.
    """
    if not folder.is_dir():
        raise InputError(f"--resume {folder}: there is no such folder")
    status = _status(folder)
    if status in _OVER:
        raise InputError(
            f"--resume {folder}: that run is over, with status {status}: there is nothing to go on with"
        )
    try:
        return Store(folder).read()
    except InputError as error:
        why = str(error).replace("\n", "; ")
        raise InputError(
            f"--resume {folder}: {why}; a run leaves checkpoints with --checkpoint, the first after that many "
            "seconds: begin it anew"
        ) from None


def _status(folder: Path) -> str | None:
    """How the run in a folder ended; None where it could not say."""
    try:
        summary: Any = json.loads((folder / SUMMARY).read_bytes())
        return str(summary["status"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


def scene_of(checkpoint: Checkpoint) -> Scene:
    """The scene that was run.

    Raises:
        InputError: This version refuses it.
    """
    try:
        return Scene.model_validate_json(json.dumps(checkpoint.scene)).named(checkpoint.scene_name)
    except (ValidationError, ValueError, TypeError) as error:
        raise InputError(f"the checkpoint's scene is refused: {error}") from None


def options_of(checkpoint: Checkpoint, asked: RunOptions) -> RunOptions:
    """How a run goes on: as it was run, but for what does not matter to that.

    Args:
        checkpoint: Of the run.
        asked: What is asked for now; what is None there is as it was.

    Raises:
        InputError: The checkpoint's make no sense.
    """
    then = checkpoint.options
    if set(then) != {"processes", "live", *_ALIKE}:
        raise InputError(f"the checkpoint's options are {', '.join(sorted(then))}")
    unsaid = RunOptions()
    for name in ("processes", *_ALIKE[:-1], "replay"):
        now = getattr(asked, name)
        if now not in (getattr(unsaid, name), then.get(name)):
            option = name.replace("_", "-")
            raise InputError(
                f"--resume: the run has --{option} {then.get(name)}, which can't be --{option} {now} now"
            )
    alike: dict[str, Any] = {name: then[name] for name in ("processes", *_ALIKE)}
    return replace(asked, **{**alike, "checkpoint_s": asked.checkpoint_s or then["checkpoint_s"]})


def told(plan: Plan, options: RunOptions, *, live: bool) -> dict[str, Any]:
    """A run's options as checkpoints have them; ``live``: whether faults may come over serial lines too."""
    return {
        "live": live,
        **{name: value for name, value in asdict(options).items() if name in _ALIKE},
        "processes": plan.setting,
        "wire": plan.wire,
    }


def bound(scene: Scene) -> dict[str, str]:
    """What the bits of a run hang on, by name."""
    from cell_firmware.cell import PerCell
    from cell_firmware.loader import load
    from plant.kernels.cache import key

    firmware = load(scene.cells)
    own = firmware.firmware if isinstance(firmware, PerCell) else firmware
    path = getsourcefile(type(own))
    return {
        **versions(),
        "the plant's kernels": key(),
        "the scene": sha256(scene.canonical()).hexdigest(),
        "the cells' program": "" if path is None else sha256(Path(path).read_bytes()).hexdigest(),
    }


def check(checkpoint: Checkpoint, now: dict[str, str]) -> None:
    """Refuse to go on where the same bits can't be promised.

    Raises:
        InputError: Names what is not as it was.
    """
    then = checkpoint.bound
    other = [
        f"{name} (then {then.get(name, 'unknown')}, now {now.get(name, 'unknown')})"
        for name in sorted(then.keys() | now.keys())
        if then.get(name) != now.get(name)
    ]
    if other:
        raise InputError(f"--resume: not as when the run began: {'; '.join(other)}")
