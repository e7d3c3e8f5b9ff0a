"""Checkpoint files of a run: the last two are retained, so that one is always whole."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from pydantic import ValidationError

from deploy.checkpoints.checkpoint import LARGEST_BYTES, Checkpoint
from deploy.errors import DeployError, InputError
from deploy.scenes.scene import Scene
from deploy.util.files import SUMMARY, sync_folder
from deploy.workers.plan import RunOptions

if TYPE_CHECKING:
    from deploy.workers.plan import Plan


FILE_NAME: Final = "checkpoint.msgpack"
PREVIOUS: Final = "checkpoint-before.msgpack"
"""The previous checkpoint."""
DRAFT: Final = ".checkpoint.msgpack.draft"
NAMES: Final = (FILE_NAME, PREVIOUS, DRAFT)


@final
class CheckpointStore:
    """Checkpoint files in a run's output folder.

    Args:
        folder: Output folder of the run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._last, self._before, self._draft = (folder / name for name in NAMES)

    def write(self, content: bytes) -> None:
        """Write the newest checkpoint, and keep the one before as the previous checkpoint.

        An interruption at any time leaves a whole checkpoint if there was one before.

        Raises:
            DeployError: It can't be written.
        """
        self._put(content, aside=True)

    def read(self) -> Checkpoint:
        """Return the newest checkpoint that is whole.

        Raises:
            InputError: There is none; the message says what is wrong with each file.
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
        """Write a checkpoint that ``read`` returned as the newest, and remove the previous one.

        A damaged newest file is overwritten, and does not become the previous checkpoint.

        Raises:
            DeployError: It can't be written.
        """
        self._put(checkpoint.to_bytes(), aside=False)
        with suppress(FileNotFoundError):
            self._before.unlink()

    def _put(self, content: bytes, *, aside: bool) -> None:
        """Write the newest checkpoint.

        Args:
            content: Content of the file.
            aside: Keep the newest checkpoint so far, which must be whole, as the previous one.
        """
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
        """Remove all checkpoint files."""
        for path in (self._draft, self._before, self._last):
            with suppress(FileNotFoundError):
                path.unlink()


_ALIKE: Final = (
    "transport",
    "wire",
    "registers",
    "messages",
    "trace_messages",
    "protocol_report",
    "respawn",
    "checkpoint_s",
)
"""Options that a resumed run takes from its checkpoint, besides the number of processes."""
_OVER: Final = ("ok", "unstable")
"""Final statuses that a resumed run would only reach again."""


def find_checkpoint(folder: Path) -> Checkpoint:
    """Return the checkpoint from which the run in a folder can resume.

    Raises:
        InputError: There is no checkpoint, or the run is over.
    """
    if not folder.is_dir():
        raise InputError(f"--resume {folder}: there is no such folder")
    status = _status(folder)
    if status in _OVER:
        raise InputError(
            f"--resume {folder}: the run is over, with status {status}: there is nothing to resume"
        )
    try:
        return CheckpointStore(folder).read()
    except InputError as error:
        why = str(error).replace("\n", "; ")
        raise InputError(
            f"--resume {folder}: {why}; a run writes checkpoints with --checkpoint SECONDS, the first after that "
            "time: start the run again"
        ) from None


def _status(folder: Path) -> str | None:
    """Return the final status of the run in a folder; None without a readable summary."""
    try:
        summary: Any = json.loads((folder / SUMMARY).read_bytes())
        return str(summary["status"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


def scene_of(checkpoint: Checkpoint) -> Scene:
    """Return the scene of a checkpoint.

    Raises:
        InputError: This version refuses it.
    """
    try:
        return Scene.model_validate_json(json.dumps(checkpoint.scene)).named(checkpoint.scene_name)
    except (ValidationError, ValueError, TypeError) as error:
        raise InputError(f"the checkpoint's scene is refused: {error}") from None


def options_of(checkpoint: Checkpoint, options: RunOptions) -> RunOptions:
    """Return the options of a resumed run: the checkpoint's where the result depends on an option, else ``options``.

    Args:
        checkpoint: Checkpoint to resume from.
        options: Options given now; a default stands for the checkpoint's value.

    Raises:
        InputError: The checkpoint's options are unknown, or ``options`` contradicts them.
    """
    then = checkpoint.options
    if set(then) != {"processes", "live", *_ALIKE}:
        raise InputError(f"the checkpoint's options are {', '.join(sorted(then))}")
    unsaid = RunOptions()
    for name in ("processes", *_ALIKE[:-1], "replay"):
        now = getattr(options, name)
        if now not in (getattr(unsaid, name), then.get(name)):
            option = name.replace("_", "-")
            raise InputError(
                f"--resume: the run has --{option} {then.get(name)}, which can't be --{option} {now} now"
            )
    alike: dict[str, Any] = {name: then[name] for name in ("processes", *_ALIKE)}
    return replace(options, **{**alike, "checkpoint_s": options.checkpoint_s or then["checkpoint_s"]})


def options_record(plan: Plan, options: RunOptions, *, live: bool) -> dict[str, Any]:
    """Return a run's options for its checkpoints; ``live``: whether serial lines are byte-accurate."""
    return {
        "live": live,
        **{name: value for name, value in asdict(options).items() if name in _ALIKE},
        "processes": plan.setting,
        "wire": plan.wire,
    }


def check(checkpoint: Checkpoint, now: dict[str, str]) -> None:
    """Refuse to resume where the same bits can't be guaranteed.

    Raises:
        InputError: The fingerprint has changed; the message names the entries.
    """
    then = checkpoint.bound
    other = [
        f"{name} (then {then.get(name, 'unknown')}, now {now.get(name, 'unknown')})"
        for name in sorted(then.keys() | now.keys())
        if then.get(name) != now.get(name)
    ]
    if other:
        raise InputError(f"--resume: changed since the run began: {'; '.join(other)}")
