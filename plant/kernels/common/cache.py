"""Disk cache of compiled kernels: loads in milliseconds, never stale.

numba's own cache notices a change of the file that holds a cached function, but not of the files of its callees.
Here the cache folder is therefore named after all inputs: the text of every kernel file, the versions of Python and
numba, and the processor. Any change of an input selects a new folder.

numba's own cache notices a change of the file that holds a cached function, but not of the files its callees live
in. So the folder is named after everything that goes in: the text of every kernel file, the versions of Python and
numba, and the processor. Any change makes another folder; nothing is ever looked up under an old name.
"""

from __future__ import annotations

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


def key() -> str:
    """Name of the set of kernels: a hash of all that their machine code depends on."""
    digest = hashlib.sha256()
    kernels = Path(__file__).parents[1]
    for path in sorted(kernels.rglob("*.py")):
        digest.update(path.relative_to(kernels).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    # numba also looks at where the cached file is and when it changed: another checkout has a folder of its own
    entry = kernels / "exact" / "block.py"
    for part in (
        version("numba"),
        version("llvmlite"),
        sys.version,
        platform.machine(),
        processor(),
        str(entry),
        str(entry.stat().st_mtime_ns),
    ):
        digest.update(part.encode() + b"\0")
    return digest.hexdigest()[:16]


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
    path = Path(home) / "mdms" / "kernels" / key()
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
