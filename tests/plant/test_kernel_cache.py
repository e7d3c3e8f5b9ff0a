"""The cache of compiled kernels: never stale, found again, and absent where it can't be kept."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from bus.kernel_cache import cache as kernel_cache
from bus.kernel_cache.cache import KernelCache
from bus.kernel_cache.locator import disk_cached
from plant.kernels.common import cache
from tests.plant.scenes import TICK_NS, study

KERNELS = cache.KERNELS
ROOT = KERNELS.parents[1]


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of all kernel files, with their times."""
    folder = tmp_path / "kernels"
    shutil.copytree(KERNELS, folder, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def _cache(folder: Path) -> KernelCache:
    """The cache of a copy, afresh."""
    return KernelCache(folder)


def test_the_key_stays_while_nothing_changes(copied: Path) -> None:
    assert _cache(copied).key() == _cache(copied).key()


FILES = sorted(path.relative_to(KERNELS).as_posix() for path in KERNELS.rglob("*.py"))


@pytest.mark.parametrize("name", FILES)
def test_a_change_of_any_kernel_file_changes_the_key(copied: Path, name: str) -> None:
    before = _cache(copied).key()
    path = copied / name
    text = path.read_text()
    path.write_text(text + "\nADDED = 1\n")
    assert _cache(copied).key() != before
    path.write_text(text)
    assert _cache(copied).key() == before


EXPRESSION = '''"""Kernels."""

PITCH: Final = 1
"""Along a row."""


def step(x):
    """Move by a step."""
    if x > 0:
        return x - (1.0 + PITCH)
    return "kept"
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("1.0 + PITCH", "1.0 - PITCH"),
        ("1.0", "1.5"),
        ("1.0", "1"),
        ("x - (1.0 + PITCH)", "x - 1.0 + PITCH"),
        ("def step(x)", "def step(x=2)"),
        ("def step", "@kernel\ndef step"),
        ("= 1\n", "= 2\n"),
        ('"kept"', '"left"'),
        ("    return", "        return"),
    ],
)
def test_a_changed_expression_changes_the_key(copied: Path, old: str, new: str) -> None:
    path = copied / "another.py"
    path.write_text(EXPRESSION)
    before = _cache(copied).key()
    assert EXPRESSION.count(old) >= 1
    path.write_text(new.join(EXPRESSION.rsplit(old, 1)))
    assert _cache(copied).key() != before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""Kernels."""', '"""Other words."""'),
        ('"""Kernels."""', ""),
        ('"""Along a row."""', "# along a column"),
        ('    """Move by a step."""\n', ""),
        ("def step", "# a comment\ndef step"),
        ("x - (1.0 + PITCH)", "(\n            x\n            - (1.0 + PITCH)\n        )"),
    ],
)
def test_a_comment_a_docstring_and_layout_do_not_change_the_key(copied: Path, old: str, new: str) -> None:
    path = copied / "another.py"
    path.write_text(EXPRESSION)
    before = _cache(copied).key()
    assert old in EXPRESSION
    path.write_text(EXPRESSION.replace(old, new))
    assert _cache(copied).key() == before


def test_times_of_files_do_not_change_the_key(copied: Path) -> None:
    before = _cache(copied).key()
    for name in FILES:
        os.utime(copied / name, (1e9, 1e9))
    assert _cache(copied).key() == before


def test_a_new_kernel_file_and_a_renamed_one_change_the_key(copied: Path) -> None:
    before = _cache(copied).key()
    (copied / "another.py").write_text("")
    with_one_more = _cache(copied).key()
    (copied / "another.py").rename(copied / "renamed.py")
    assert len({before, with_one_more, _cache(copied).key()}) == 3


def test_a_number_moved_from_one_file_to_the_next_changes_the_key(copied: Path) -> None:
    """Names and lengths are part of the text: files can't be glued together to the same hash."""
    (copied / "one.py").write_text("a = 1\n")
    (copied / "two.py").write_text("b = 2\n")
    before = _cache(copied).key()
    (copied / "one.py").write_text("a = 1\nb = 2\n")
    (copied / "two.py").write_text("")
    assert _cache(copied).key() != before


@pytest.mark.parametrize(("what", "another"), [("version", "9"), ("level", ("x86-64-v9", ""))])
def test_other_versions_and_processors_have_other_keys(
    copied: Path, monkeypatch: pytest.MonkeyPatch, what: str, another: object
) -> None:
    before = _cache(copied).key()
    monkeypatch.setattr(kernel_cache, what, lambda *_: another)
    assert _cache(copied).key() != before


def _fresh(code: str, **environment: str) -> dict[str, object]:
    """What a new process prints as JSON on its last line."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


SECOND_PROCESS = """
import json, sys
import numba
from plant.kernels.common import cache
warm = cache.is_warm()
import numpy as np
from tests.plant.scenes import TICK_NS, study
plant = study()
sense, _ = plant.advance(np.zeros((400, 2)), TICK_NS)
from plant.kernels.exact import entry
print(json.dumps({
    "warm": warm,
    "hits": [sum(kernel.stats.cache_hits.values()) for kernel in (entry.advance_block, entry.cover)],
    "misses": [sum(kernel.stats.cache_misses.values()) for kernel in (entry.advance_block, entry.cover)],
    "present": int(sense.presence.sum()),
    "imported": [name for name in ("numba.np.arraymath", "numba.np.linalg") if name in sys.modules],
    "sorted": numba.njit(lambda values: np.sort(values))(np.array([2.0, 1.0])).tolist(),
}))
"""


def _files() -> dict[str, int]:
    """Files of machine code, and when they were written."""
    return {str(path): path.stat().st_mtime_ns for path in cache.folder()[0].rglob("*.nbc")}


def test_a_second_process_loads_what_the_first_compiled() -> None:
    plant = study()
    sense, _ = plant.advance(np.zeros((400, 2)), TICK_NS)
    if not cache.folder()[1]:
        pytest.skip("no cache folder can be written here")
    before = _files()
    assert before
    assert cache.is_warm()
    found = _fresh(SECOND_PROCESS)
    assert found["warm"] is True
    assert found["hits"] == [1, 1]
    assert found["misses"] == [0, 0]
    assert found["present"] == int(sense.presence.sum())
    assert found["imported"] == []  # as only compiling needs
    assert found["sorted"] == [1.0, 2.0]  # which was compiled then
    assert _files().items() >= before.items()  # tests that run beside this one may compile more


FOLDER = """
import json
from plant.kernels.common import cache
path, lasting = cache.folder()
print(json.dumps({"path": str(path), "exists": path.is_dir(), "lasting": lasting, "warm": cache.is_warm()}))
"""


def test_a_cache_that_cannot_be_written_is_replaced_for_the_process_and_removed_with_it(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("no folder")
    found = _fresh(FOLDER, NUMBA_CACHE_DIR=str(tmp_path / "file"), TMPDIR=str(tmp_path))
    assert found["lasting"] is False
    assert found["exists"] is True
    assert found["warm"] is False
    assert Path(str(found["path"])).parents[1] == tmp_path
    assert not Path(str(found["path"])).exists()


def test_a_kernel_that_the_disk_has_no_room_for_is_compiled_and_used() -> None:
    def more(x: int) -> int:
        return x + 1

    more.__module__ = "plant.kernels.more"
    with disk_cached(more.__module__):
        compiled = numba.njit(cache=True)(more)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        with pytest.warns(RuntimeWarning, match="compiled kernels can't be kept in .*: File too large"):
            assert compiled(1) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_the_cache_goes_where_the_environment_says(tmp_path: Path) -> None:
    found = _fresh(FOLDER, NUMBA_CACHE_DIR=str(tmp_path / "numba"), XDG_CACHE_HOME=str(tmp_path / "xdg"))
    assert str(found["path"]).startswith(str(tmp_path / "numba" / "mdms" / "kernels"))
    assert found["lasting"] is True
    environment = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": str(tmp_path / "xdg")}
    assert str(_fresh(FOLDER, **environment)["path"]).startswith(str(tmp_path / "xdg" / "mdms" / "kernels"))


def test_texts_that_differ_in_comments_share_a_folder_and_others_do_not(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However the folder was found: by the note of a text seen before, or by parsing a new one."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    first, _ = _cache(copied).folder()
    parsed: list[bytes] = []
    tree = kernel_cache._tree

    def counted(text: bytes) -> bytes:
        parsed.append(text)
        return tree(text)

    monkeypatch.setattr(kernel_cache, "_tree", counted)

    def found() -> Path:
        return _cache(copied).folder()[0]

    assert found() == first
    assert not parsed
    path = copied / "common" / "layout.py"
    path.write_text(path.read_text() + "\n# a comment\n")
    assert found() == first
    assert parsed
    path.write_text(path.read_text() + "\nADDED = 1\n")
    assert found() != first


def test_only_the_latest_of_the_old_folders_are_retained(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kernels = tmp_path / "mdms" / "kernels"
    for age in range(20):
        old = kernels / f"old{age:02}"
        old.mkdir(parents=True)
        (old / "kernel.nbi").write_text("")
        os.utime(old, (1e9 - age, 1e9 - age))
    path, _ = _cache(copied).folder()
    retained = sorted(folder.name for folder in kernels.iterdir() if folder != path)
    assert retained == [f"old{age:02}" for age in range(cache.RETAINED)]
