"""Private folders for Unix sockets, which don't stay behind for long when their process is killed."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self, final

from deploy.errors import DeployError

PREFIX: Final = "mdms-socket-"
"""Of the folders' names; everything else of this program in the folder for temporary files has another."""
_PATH_LIMIT: Final = 100
"""Characters in the path of a Unix socket; systems allow 104 or 108 bytes, the lock beside it included."""
_OWN: Final = 28
"""Characters of it that the folder's own name and the socket's take."""


@final
class SocketFolder:
    """A new folder that only this user can enter, with a path that is short enough for a socket's.

    The folder is locked (``flock``) until it is closed or the process ends, however that ends. Making one removes this
    user's folders that nobody locks any more: processes that were killed left them.

    Attributes:
        path: The folder.

    Raises:
        DeployError: It can't be made.
    """

    def __init__(self) -> None:
        where = tempfile.gettempdir()
        where = where if len(where) < _PATH_LIMIT - _OWN else "/tmp"
        _remove_stale(Path(where))
        try:
            self._handle: int | None = None
            while self._handle is None:
                self.path: Path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=where))
                self._handle = _locked(self.path)
        except OSError as error:
            raise DeployError(f"can't make a folder for the run's socket: {error}") from error

    def close(self) -> None:
        """Remove the folder; a second call does nothing."""
        if self._handle is None:
            return
        shutil.rmtree(self.path, ignore_errors=True)  # before the lock goes: afterwards it may be another's
        os.close(self._handle)
        self._handle = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _locked(path: Path) -> int | None:
    """A handle on a new folder that holds its lock; None where another process took it for a stale one before.

    Raises:
        OSError: It can't be opened.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    # A file system without locks: nobody can tell that the folder is stale, nor take it for one.
    with suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_SH)  # waits for whoever looks whether it is stale
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(handle), path.stat()):
            return handle
    os.close(handle)
    return None


def _remove_stale(where: Path) -> None:
    """Remove this user's socket folders that no living process has locked."""
    for path in where.glob(f"{PREFIX}*"):
        with suppress(OSError):  # another user's, no folder, or another process removes it too
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            try:
                if os.fstat(handle).st_uid == os.getuid():
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(path)
            finally:
                os.close(handle)
