"""Where a run's checkpoints lie: the last two, so that there is always a whole one."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final, final

from deploy.checkpoints.checkpoint import LARGEST_BYTES, Checkpoint
from deploy.errors import DeployError, InputError
from deploy.files import sync_folder

FILE_NAME: Final = "checkpoint.msgpack"
BEFORE: Final = "checkpoint-before.msgpack"
"""The one before the last."""
DRAFT: Final = ".checkpoint.msgpack.draft"
NAMES: Final = (FILE_NAME, BEFORE, DRAFT)


@final
class Store:
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
