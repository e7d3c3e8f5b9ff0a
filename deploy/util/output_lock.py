"""Exclusive lock on an output folder: one process at a time writes results there."""

from __future__ import annotations

import fcntl
import itertools
import os
import socket
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self, final

from deploy.errors import InputError

FILE_NAME: Final = ".mdms.lock"
_LONGEST_NOTE: Final = 512
"""Bytes that are read of a lock file's note."""


@final
class OutputLock:
    """Lock on a folder that exists, taken at once and held until it is released or the process ends.

    The lock is ``flock`` on a file in the folder. The operating system releases it however the process ends, so a
    file that a killed process left behind locks nothing. The file names its holder for the error message only.

    On a file system that can't lock files the folder is used without a lock, with a warning.

    Args:
        folder: The folder.
        warn: Told, in one line, that the file system has no locks.
        named: How the error messages name the folder's option.

    Attributes:
        folder: The folder.

    Raises:
        InputError: Another process, or another run of this one, holds the lock, or nothing can be written there.
    """

    def __init__(self, folder: Path, warn: Callable[[str], None], *, named: str = "output") -> None:
        self.folder: Path = folder
        self._path = folder / FILE_NAME
        self._named = named
        self._handle: int | None = None
        while self._handle is None:
            handle = self._opened()
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = _holder(handle)
                os.close(handle)
                raise InputError(
                    f"{named} {folder}: {holder} is writing there; wait until it has ended"
                ) from None
            except OSError as error:
                os.close(handle)
                warn(
                    f"{named} {folder}: files can't be locked there ({error.strerror or error}); "
                    "let no other command write there meanwhile"
                )
                return
            if _is_at(handle, self._path):
                self._handle = handle
            else:  # the holder before removed the file after this one had opened it
                os.close(handle)
        with suppress(OSError):  # a full disk: the lock holds all the same
            os.ftruncate(self._handle, 0)
            os.pwrite(self._handle, f"{os.getpid()} {socket.gethostname()}\n".encode(), 0)

    def _opened(self) -> int:
        try:
            # No O_TRUNC: the note may be another holder's. Writable, as network file systems want it for a lock.
            return os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise InputError(
                f"{self._named} {self.folder}: can't be written to: {error.strerror or error}"
            ) from None

    def release(self) -> None:
        """Remove the file and let others lock the folder; a second call does nothing."""
        if self._handle is None:
            return
        with suppress(OSError):
            self._path.unlink()  # before the release: afterwards it may be another's
        os.close(self._handle)
        self._handle = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


@contextmanager
def locked_folder(wanted: Path | None, warn: Callable[[str], None]) -> Generator[Path | None]:
    """Create the folder of ``--output`` if missing, and hold its lock inside the context.

    A folder that was made here and is empty when the work is cut short is removed.

    Args:
        wanted: The folder; what is in it stays. None: none was requested.
        warn: Told, in one line, that the folder can't be locked.

    Raises:
        InputError: The folder can't be made or written to, or another process writes there.
    """
    if wanted is None:
        yield None
        return
    new = not wanted.exists()
    try:
        wanted.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f"output {wanted}: is a file, must be a folder") from None
    except OSError as error:
        raise InputError(f"output {wanted}: can't be made: {error.strerror or error}") from None
    try:
        with OutputLock(wanted, warn):
            yield wanted
    except BaseException:
        if new:
            with suppress(OSError):  # something has been written there: it stays
                wanted.rmdir()
        raise


def new_folder(name: str) -> Path:
    """Make a folder under ``runs/``, numbered where there is one of that name.

    Raises:
        InputError: It can't be made.
    """
    first = folder = Path("runs") / name
    for number in itertools.count(2):
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            folder = first.with_name(f"{first.name}-{number}")
        except OSError as error:
            raise InputError(f"output {folder}: can't be made: {error.strerror or error}") from None
        else:
            break
    return folder


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file is still the file at that path, neither removed nor replaced."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _holder(handle: int) -> str:
    """Name the process that a lock file's note names, as far as the note can be right."""
    try:
        pid, host = os.pread(handle, _LONGEST_NOTE, 0).decode().split()
        number = int(pid)
    except (OSError, ValueError):  # not written yet
        return "another process"
    if host != socket.gethostname():
        return f"process {number} on {host}"
    try:
        os.kill(number, 0)
    except PermissionError:  # another user's: it lives
        pass
    except OSError:  # the note of a process that was killed: the holder has not written its own yet
        return "another process"
    return f"process {number}"
