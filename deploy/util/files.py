"""Atomic file writes and other file helpers."""

from __future__ import annotations

import os
import platform
from collections.abc import Generator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from deploy.errors import DeployError

SUMMARY = "summary.json"
_VERSIONS = ("mdms-emulator", "eclipse-zenoh", "llvmlite", "mcap", "msgpack", "numba", "numpy", "scipy")


@contextmanager
def atomic_write(path: Path) -> Generator[Path]:
    """A draft to write to, which becomes the file in the end: it is there whole, or as it was before.

    Raises:
        DeployError: It can't be written.
    """
    # Of this process alone: `mdms plot` may draw what the run itself is drawing.
    draft = path.with_name(f".{path.name}.{os.getpid()}.draft")
    try:
        yield draft
        draft.replace(path)
    except OSError as error:
        # a library may put a story into strerror
        why = error if error.errno is None else os.strerror(error.errno)
        raise DeployError(f"can't write {path}: {why}") from error
    finally:
        with suppress(OSError):
            draft.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text, whole or not at all.

    Raises:
        DeployError: It can't be written.
    """
    with atomic_write(path) as draft:
        draft.write_text(text, encoding="utf-8")


def made_folder(folder: Path) -> Path:
    """Make a folder with its parents, unless it is there.

    Raises:
        DeployError: It can't be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DeployError(f"can't make the folder {folder}: {error.strerror or error}") from error
    return folder


def sync_folder(folder: Path) -> None:
    """Have a folder's names, such as that of a file just renamed, survive a loss of power.

    Raises:
        OSError: As the operating system has it.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def versions() -> dict[str, str]:
    """Return the versions of this package, Python and the libraries that affect a run's bits."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in _VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a checkout that is not installed
            found[name] = "not installed"
    return found
