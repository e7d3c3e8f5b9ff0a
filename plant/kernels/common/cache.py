"""Disk cache of compiled kernels: loads in milliseconds, never stale.

numba's own cache notices a change of the file that holds a cached function, but not of the files of its callees.
Here the cache folder is therefore named after all inputs: the syntax tree of every kernel file, the versions of Python
and numba, and the processor. Any change of an input selects a new folder. Comments, docstrings and layout are no
input. numba still compares the text of the file that holds a cached function, and the line it begins at, so a comment
in such a file compiles that file's own cached functions again, into the same folder.
"""

from __future__ import annotations

import ast
import atexit
import contextlib
import hashlib
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path

RETAINED = 8
"""Folders of other versions that stay; the oldest beyond that are removed."""

KERNELS = Path(__file__).parents[1]
"""All kernels."""

TEXTS = "texts"
"""Subfolder with an empty file for each set of texts that the folder is the one for, named after their hash."""


def key() -> str:
    """Name of the set of kernels: a hash of all that their machine code depends on."""
    digest = hashlib.sha256(_surroundings())
    for name, text in _sources():
        digest.update(name.encode() + b"\0" + _tree(text))
    return digest.hexdigest()[:16]


def _sources() -> list[tuple[str, bytes]]:
    """Names and texts of all kernel files."""
    return [
        (path.relative_to(KERNELS).as_posix(), path.read_bytes()) for path in sorted(KERNELS.rglob("*.py"))
    ]


def _surroundings() -> bytes:
    """All that machine code depends on beside the kernels' text, and where they lie: numba tells places apart."""
    parts = (
        version("numba"),
        version("llvmlite"),
        sys.version,
        platform.machine(),
        processor(),
        str(KERNELS),
    )
    return b"".join(part.encode() + b"\0" for part in parts)


@cache
def _tree(text: bytes) -> bytes:
    """Hash of the syntax tree of a file without docstrings, line numbers and layout."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [statement for statement in node.body if not _is_words(statement)]
    return hashlib.sha256(ast.dump(tree).encode()).digest()


def _is_words(statement: ast.AST) -> bool:
    """Whether a statement is a string by itself: a docstring, or that of a constant."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _key_on_disk(home: Path) -> str:
    """The key, found without parsing where a folder was made for these very texts: parsing takes 0.2 s."""
    digest = hashlib.sha256(_surroundings())
    for name, text in _sources():
        digest.update(name.encode() + b"\0" + text + b"\0")
    note = Path(TEXTS) / digest.hexdigest()[:16]
    for found in home.glob(f"*/{note}"):
        return found.parents[1].name
    name = key()
    with contextlib.suppress(OSError):
        (home / name / TEXTS).mkdir(parents=True, exist_ok=True)
        (home / name / note).touch()
    return name


def processor() -> str:
    """The processor's name and features, as far as the system tells."""
    with contextlib.suppress(OSError):
        for line in (
            Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n")[0].splitlines()
        ):
            if line.startswith(("flags", "Features")):
                return platform.processor() + line
    return platform.processor()


@cache
def folder() -> tuple[Path, bool]:
    """The folder of this set of kernels, created; and whether later runs will find it again.

    ``NUMBA_CACHE_DIR`` where that is set, else the user's cache; a temporary folder where that can't be written.
    """
    home = (
        os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    )
    kernels = Path(home) / "mdms" / "kernels"
    path = kernels / _key_on_disk(kernels)
    with contextlib.suppress(OSError):
        path.mkdir(parents=True, exist_ok=True)
        os.utime(path)
        with tempfile.TemporaryFile(dir=path):
            _prune(path)
        return path, True
    # a fresh folder of our own: compiled code must not be read from where others can write
    temporary = Path(tempfile.mkdtemp(prefix="mdms-kernels-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary, False


def _prune(current: Path) -> None:
    """Remove the oldest folders of other versions."""
    others = [path for path in current.parent.iterdir() if path != current and path.is_dir()]
    with contextlib.suppress(OSError):
        others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        for path in others[RETAINED:]:
            shutil.rmtree(path, ignore_errors=True)


def is_warm() -> bool:
    """Whether the kernels are compiled already; the first run of a version takes seconds to compile them."""
    return any(folder()[0].rglob("*.nbi"))


@contextlib.contextmanager
def disk_cached() -> Iterator[None]:
    """Functions compiled with ``cache=True`` inside this block are kept in ``folder()``."""
    from numba.core import config

    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder()[0])
    try:
        yield
    finally:
        config.CACHE_DIR = before
