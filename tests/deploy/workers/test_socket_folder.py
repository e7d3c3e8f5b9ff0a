"""Folders of sockets: private, locked while their process lives, removed by the next process once it was killed."""

from __future__ import annotations

import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from deploy.workers.socket_folder import PREFIX, SocketFolder
from tests.system.running import Mdms
from tests.system.small import small_scene

ROOT = Path(__file__).parents[3]
HOLDER = """
import time
from deploy.workers.socket_folder import SocketFolder
folder = SocketFolder()
(folder.path / "run").touch()
print(folder.path, flush=True)
time.sleep(60)
"""
Holder = tuple[subprocess.Popen[str], Path]


@pytest.fixture
def where(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for temporary files of these tests alone, with a short path."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        monkeypatch.setenv("TMPDIR", folder)
        monkeypatch.setattr(tempfile, "tempdir", None)
        yield Path(folder)


@pytest.fixture
def holder() -> Iterator[Callable[[], Holder]]:
    """Starts processes that hold a folder, and ends them."""
    with ExitStack() as stack:

        def start() -> Holder:
            process = stack.enter_context(
                subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True, cwd=ROOT)
            )
            stack.callback(process.kill)
            assert process.stdout is not None
            return process, Path(process.stdout.readline().strip())

        yield start


def _killed(held: Holder) -> Path:
    process, path = held
    process.kill()
    process.wait()
    assert (path / "run").exists(), "nobody cleans up after a SIGKILL"
    return path


def test_a_folder_is_this_user_s_alone_and_goes_when_it_is_closed(where: Path) -> None:
    with SocketFolder() as folder:
        assert folder.path.parent == where
        assert stat.S_IMODE(folder.path.stat().st_mode) == 0o700
        (folder.path / "run").touch()
    assert list(where.iterdir()) == []
    folder.close()


def test_the_folder_of_a_killed_process_goes_with_the_next_start_and_a_living_one_s_stays(
    where: Path, holder: Callable[[], Holder]
) -> None:
    stale, (_, living) = _killed(holder()), holder()
    assert not stale.exists(), "the second process came after the first was killed"
    for name in ("mdms-kernels-x", "other", f"{PREFIX}file"):
        (where / name).touch() if name.endswith("file") else (where / name).mkdir()
    target = where / "target"
    target.mkdir()
    (where / f"{PREFIX}link").symlink_to(target)
    before = set(where.iterdir())
    with SocketFolder() as folder:
        assert set(where.iterdir()) == before | {folder.path}
        assert (living / "run").exists()


def test_one_that_was_stopped_in_a_debugger_keeps_its_folder(
    where: Path, holder: Callable[[], Holder]
) -> None:
    process, path = holder()
    process.send_signal(signal.SIGSTOP)
    with SocketFolder():
        assert path.parent == where
        assert path.exists()


def test_a_folder_that_was_taken_for_a_stale_one_as_it_was_made_is_made_again(
    where: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Path] = []

    def mkdtemp(prefix: str, dir: str) -> str:  # noqa: A002
        path = Path(dir) / f"{prefix}{len(made)}"
        made.append(path)
        if len(made) > 1:
            path.mkdir()
        return str(path)

    monkeypatch.setattr(tempfile, "mkdtemp", mkdtemp)
    with SocketFolder() as folder:
        assert folder.path == made[1]
    assert list(where.iterdir()) == []


@pytest.mark.slow
def test_a_killed_run_s_folder_goes_with_the_next_run(where: Path, tmp_path: Path) -> None:
    scene = tmp_path / "small.toml"
    scene.write_text(small_scene())
    command = [sys.executable, "-m", "deploy.cli", "run", str(scene), "--no-picture", "-q", "--output"]

    def sockets() -> list[Path]:
        return [path for path in where.iterdir() if path.name.startswith(PREFIX)]

    more = ["--realtime", "--duration", "600", "--processes", "2"]
    running = Mdms.started([*command, str(tmp_path / "one"), *more], tmp_path / "one")
    try:
        running.wait_until_recorded(1_000)
        (stale,) = sockets()
    finally:
        running.process.kill()
        running.process.communicate()
    running.assert_nothing_left()
    assert sockets() == [stale]
    after = Mdms.started([*command, str(tmp_path / "two"), "--processes", "2"], tmp_path / "two")
    _, stderr = after.process.communicate(timeout=60.0)
    assert (after.process.returncode, stderr) == (0, "")
    assert sockets() == []
