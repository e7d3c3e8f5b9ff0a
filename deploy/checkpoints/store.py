"""Where a run's checkpoints lie: the last two, so that there is always a whole one."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import asdict, replace
from hashlib import sha256
from inspect import getsourcefile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from pydantic import ValidationError

from deploy.checkpoints.checkpoint import LARGEST_BYTES, Checkpoint
from deploy.errors import DeployError, InputError
from deploy.scenes.scene import Scene
from deploy.util.files import SUMMARY, sync_folder, versions
from deploy.workers.plan import RunOptions

if TYPE_CHECKING:
    from deploy.workers.plan import Plan


FILE_NAME: Final = "checkpoint.msgpack"
PREVIOUS: Final = "checkpoint-before.msgpack"
"""The one before the last."""
DRAFT: Final = ".checkpoint.msgpack.draft"
NAMES: Final = (FILE_NAME, PREVIOUS, DRAFT)


@final
class CheckpointStore:
    """The checkpoints in a run's output folder.

    Args:
        folder: That folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._last, self._before, self._draft = (folder / name for name in NAMES)

    def write(self, content: bytes) -> None:
        """Make this the last checkpoint. Whenever this is cut short, a whole one is there, if there was one.

        Raises:
            DeployError: It can't be written.
        """
        self._put(content, aside=True)

    def read(self) -> Checkpoint:
        """The last checkpoint that is whole.

        Raises:
            InputError: There is none; says what is the matter with those that are there.
        """
        wrong: list[str] = []
        for path in (self._last, self._before):
            try:
                if path.stat().st_size > LARGEST_BYTES:
                    raise InputError(f"must be at most {LARGEST_BYTES} bytes")
                return Checkpoint.from_bytes(path.read_bytes())
            except FileNotFoundError:
                continue
            except OSError as error:
                wrong.append(f"{path}: {error.strerror or error}")
            except InputError as error:
                wrong.append(f"{path}: {error}")
        raise InputError("\n".join(wrong) or f"there is no checkpoint in {self._folder}")

    def keep(self, checkpoint: Checkpoint) -> None:
        """Have this one be the last, which `read` gave: one that is not whole must not take its place.

        Raises:
            DeployError: It can't be written.
        """
        self._put(checkpoint.to_bytes(), aside=False)
        with suppress(FileNotFoundError):
            self._before.unlink()

    def _put(self, content: bytes, *, aside: bool) -> None:
        """Make this the last; ``aside``: what was the last, and is whole, is the one before it then."""
        try:
            with self._draft.open("wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            if aside and self._last.exists():
                self._last.replace(self._before)
            self._draft.replace(self._last)
            sync_folder(self._folder)
        except OSError as error:
            raise DeployError(f"can't write {self._last}: {error.strerror or error}") from error

    def clear(self) -> None:
        """Remove them all."""
        for path in (self._draft, self._before, self._last):
            with suppress(FileNotFoundError):
                path.unlink()


_ALIKE: Final = ("transport", "wire", "registers", "protocol_report", "respawn", "checkpoint_s")
"""Options that a resumed run has from the run it goes on with; the number of processes as the plan has it."""
_OVER: Final = ("ok", "unstable")
"""Ends that going on from a checkpoint could only come to again."""


def find_checkpoint(folder: Path) -> Checkpoint:
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
        return CheckpointStore(folder).read()
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


def options_record(plan: Plan, options: RunOptions, *, live: bool) -> dict[str, Any]:
    """A run's options as checkpoints have them; ``live``: whether faults may come over serial lines too."""
    return {
        "live": live,
        **{name: value for name, value in asdict(options).items() if name in _ALIKE},
        "processes": plan.setting,
        "wire": plan.wire,
    }


def fingerprint(scene: Scene) -> dict[str, str]:
    """What the bits of a run hang on, by name."""
    from cell_firmware.cell import PerCellAdapter
    from cell_firmware.loader import load
    from plant.kernels.common.cache import key

    firmware = load(scene.cells)
    own = firmware.firmware if isinstance(firmware, PerCellAdapter) else firmware
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
