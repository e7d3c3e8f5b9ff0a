"""Files and folders that commands leave behind."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from deploy.errors import DeployError, InputError


@contextmanager
def written_whole(path: Path) -> Generator[Path]:
    """A draft to write to, which becomes the file in the end: it is there whole, or as it was before.

    Raises:
        DeployError: It can't be written.
    """
    draft = path.with_name(f".{path.name}.draft")
    try:
        yield draft
        draft.replace(path)
    except OSError as error:
        raise DeployError(f"can't write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            draft.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text, whole or not at all.

    Raises:
        DeployError: It can't be written.
    """
    with written_whole(path) as draft:
        draft.write_text(text, encoding="utf-8")


def made_folder(wanted: Path) -> Path:
    """Make the folder that ``--output`` names, if it isn't there; what is in it stays.

    Raises:
        InputError: It can't be made.
    """
    try:
        wanted.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f"output {wanted}: is a file, must be a folder") from None
    except OSError as error:
        raise InputError(f"output {wanted}: can't be made: {error.strerror or error}") from None
    return wanted
