"""Disk cache of compiled kernels: loads in milliseconds, never stale, and can be passed on.

numba's own cache notices a change of the file that holds a cached function, but not of the files of its callees.
Here the cache folder is therefore named after all inputs: the syntax tree of every kernel file, the versions of Python
and numba, and the level of the processor. Any change of an input selects a new folder. Comments, docstrings, layout,
and the place of the files are no input.

A wheel brings such a folder (``KernelCache.shipped``). The first run copies it to the user's cache, where other kernels
join it.
"""

from __future__ import annotations

import ast
import atexit
import contextlib
import hashlib
import json
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import final

from bus.kernel_cache.processor import level

RETAINED = 8
"""Folders of other versions that stay; the oldest beyond that are removed."""

MADE_FOR = "made_for.json"
"""File beside the folders that came with a wheel, with the `surroundings` they were made in."""

_COMPILER = Path(__file__).with_name("callee.py")

TEXTS = "texts"
"""Subfolder with an empty file for each set of texts that the folder is the one for, named after their hash."""


def surroundings() -> dict[str, str]:
    """All that machine code depends on beside the kernels' text, by its name for people."""
    name, features = level()
    return {
        "numba": version("numba"),
        "llvmlite": version("llvmlite"),
        "Python": f"{sys.implementation.name} {sys.version_info.major}.{sys.version_info.minor}",
        "platform": f"{sys.platform} {platform.machine()}",
        "processor": f"{name} {features}".strip(),
    }


def _surroundings() -> bytes:
    return json.dumps(surroundings()).encode() + b"\0"


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


def _prune(current: Path) -> None:
    """Remove the oldest folders of other versions."""
    others = [path for path in current.parent.iterdir() if path != current and path.is_dir()]
    with contextlib.suppress(OSError):
        others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        for path in others[RETAINED:]:
            shutil.rmtree(path, ignore_errors=True)


@final
class KernelCache:
    """Cache of one package's kernels.

    Args:
        kernels: Folder of all its kernels.

    Attributes:
        kernels: That folder.
        shipped: Folders that came with a wheel, in the form of the user's; read only.
    """

    def __init__(self, kernels: Path) -> None:
        self.kernels = kernels
        self.shipped = kernels.parent / "compiled_kernels"

    def key(self) -> str:
        """Name of the set of kernels: a hash of all that their machine code depends on."""
        digest = hashlib.sha256(_surroundings())
        for name, text in self._sources():
            digest.update(name.encode() + b"\0" + _tree(text))
        return digest.hexdigest()[:16]

    def _sources(self) -> list[tuple[str, bytes]]:
        """Names and texts of all kernel files, and of the file that says how they are compiled."""
        files = [
            (path.relative_to(self.kernels).as_posix(), path) for path in sorted(self.kernels.rglob("*.py"))
        ]
        return [(name, path.read_bytes()) for name, path in [*files, (_COMPILER.name, _COMPILER)]]

    def mismatch(self) -> str:
        """Return the difference that keeps a wheel's kernels from being used here; empty without one."""
        try:
            made_for: Mapping[str, str] = json.loads((self.shipped / MADE_FOR).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return ""
        here = surroundings()
        return ", ".join(
            f"{name} {made_for.get(name, 'unknown')} (here {found})"
            for name, found in here.items()
            if made_for.get(name) != found
        )

    def _key_on_disk(self, home: Path) -> str:
        """The key, found without parsing where a folder was made for these very texts: parsing takes 0.2 s."""
        digest = hashlib.sha256(_surroundings())
        for name, text in self._sources():
            digest.update(name.encode() + b"\0" + text + b"\0")
        note = Path(TEXTS) / digest.hexdigest()[:16]
        for place in (home, self.shipped):
            for found in place.glob(f"*/{note}"):
                return found.parents[1].name
        name = self.key()
        with contextlib.suppress(OSError):
            (home / name / TEXTS).mkdir(parents=True, exist_ok=True)
            (home / name / note).touch()
        return name

    @cache  # noqa: B019 - there is one object a package
    def folder(self) -> tuple[Path, bool]:
        """The folder of this set of kernels, created; and whether later runs will find it again.

        ``NUMBA_CACHE_DIR`` where that is set, else the user's cache; a temporary folder where that can't be written.
        """
        home = (
            os.environ.get("NUMBA_CACHE_DIR")
            or os.environ.get("XDG_CACHE_HOME")
            or str(Path.home() / ".cache")
        )
        kernels = Path(home) / "mdms" / "kernels"
        path = kernels / self._key_on_disk(kernels)
        with contextlib.suppress(OSError):
            if not any(path.glob("*/*.nbi")):
                self._copy_shipped(path)
            path.mkdir(parents=True, exist_ok=True)
            os.utime(path)
            with tempfile.TemporaryFile(dir=path):
                _prune(path)
            return path, True
        # a fresh folder of our own: compiled code must not be read from where others can write
        temporary = Path(tempfile.mkdtemp(prefix="mdms-kernels-"))
        atexit.register(shutil.rmtree, temporary, ignore_errors=True)
        place = temporary / path.name
        place.mkdir()
        self._copy_shipped(place)
        return place, False

    def _copy_shipped(self, path: Path) -> None:
        """Copy a folder that came with a wheel, if it did, to where it can be written.

        File by file, each whole or not there: other processes may do the same.
        """
        shipped = self.shipped / path.name
        for source in sorted(
            shipped.rglob("*"), key=lambda file: file.suffix == ".nbi"
        ):  # an index after what it lists
            target = path / source.relative_to(shipped)
            if source.is_file() and not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                unfinished = target.with_name(f"{target.name}.{os.getpid()}")
                shutil.copyfile(source, unfinished)
                unfinished.replace(target)

    def is_warm(self) -> bool:
        """Whether any kernels are compiled already."""
        return any(self.folder()[0].rglob("*.nbi"))


@cache
def cache_of(module: str) -> KernelCache:
    """Return the cache of a module of kernels, which is that of ``plant.kernels`` or of another package's kernels."""
    package = f"{module.partition('.kernels')[0]}.kernels"
    return KernelCache(Path(str(sys.modules[package].__file__)).parent)
