"""One process at a time writes into an output folder; who dies holds nothing."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from deploy import cli
from deploy.errors import InputError
from deploy.util.output_lock import FILE_NAME, OutputLock, locked_folder, new_folder

ROOT = Path(__file__).parents[3]
HOLDER = """
import sys, time
from pathlib import Path
from deploy.util.output_lock import OutputLock
lock = OutputLock(Path(sys.argv[1]), print)
print("locked", flush=True)
time.sleep(60)
"""


def _no_warning(line: str) -> None:
    raise AssertionError(line)


@contextmanager
def _held(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has locked a folder."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, folder], stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "locked\n"
        try:
            yield holder
        finally:
            holder.kill()


def test_a_folder_in_use_is_refused_with_its_name_and_the_process_and_free_after_a_kill(
    tmp_path: Path,
) -> None:
    with _held(tmp_path) as holder:
        with pytest.raises(InputError) as refused:
            OutputLock(tmp_path, _no_warning)
        assert str(refused.value) == (
            f"output {tmp_path}: process {holder.pid} is writing there; wait until it has ended"
        )
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
    assert (tmp_path / FILE_NAME).exists()
    with OutputLock(tmp_path, _no_warning):
        assert (tmp_path / FILE_NAME).read_text() == f"{os.getpid()} {socket.gethostname()}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "command",
    [
        ["run", "elliptic", "--processes", "0", "--transport", "memory", "--output", "DIR"],
        ["run", "--resume", "DIR"],
        ["simulate", "elliptic", "--output", "DIR"],
        ["campaign", "heat", "--seeds", "1", "--output", "DIR"],
        ["accuracy", "elliptic", "--quick", "--output", "DIR"],
        ["accuracy", "--docs", "DIR"],
        ["effects", "elliptic", "--ladder", "--output", "DIR"],
        ["orientations", "elliptic", "--output", "DIR"],
    ],
    ids=" ".join,
)
def test_every_command_that_writes_into_a_folder_refuses_one_in_use_in_a_line(
    command: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "summary.json").write_text("of the other run")
    with OutputLock(tmp_path, _no_warning):
        assert cli.main([str(tmp_path) if word == "DIR" else word for word in command]) == 2
        said = capfd.readouterr()
        assert said.out == ""
        option = "--resume" if "--resume" in command else "output"
        assert said.err.splitlines()[-1] == (
            f"{option} {tmp_path}: process {os.getpid()} is writing there; wait until it has ended"
        )
        assert sorted(path.name for path in tmp_path.iterdir()) == [FILE_NAME, "summary.json"]
    assert (tmp_path / "summary.json").read_text() == "of the other run"


@pytest.mark.parametrize(
    ("note", "problem"),
    [
        ("", "another process is writing"),
        ("no number\n", "another process is writing"),
        ("4711 elsewhere\n", "process 4711 on elsewhere is writing"),
        (f"{2**22 + 1} {socket.gethostname()}\n", "another process is writing"),
        (f"1 {socket.gethostname()}\n", "process 1 is writing"),
    ],
    ids=["not written yet", "spoilt", "another machine", "a dead one's", "somebody else's"],
)
def test_the_holder_is_named_as_far_as_it_is_known(note: str, problem: str, tmp_path: Path) -> None:
    with OutputLock(tmp_path, _no_warning):
        (tmp_path / FILE_NAME).write_text(note)
        with pytest.raises(InputError, match=problem):
            OutputLock(tmp_path, _no_warning)


@pytest.mark.parametrize("error", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_where_files_can_not_be_locked_that_is_said_and_the_run_goes_on(
    error: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(handle: int, operation: int) -> None:
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(fcntl, "flock", without)
    said: list[str] = []
    with locked_folder(tmp_path / "new", said.append) as folder, locked_folder(folder, said.append):
        pass
    problem = f"output {folder}: files can't be locked there ({os.strerror(error)}); let no other command write there"
    assert said == 2 * [f"{problem} meanwhile"]


def test_a_folder_that_can_not_be_written_to_is_bad_input() -> None:
    # /proc refuses even the superuser, whom file modes would not stop.
    with pytest.raises(InputError, match=r"^output /proc/self: can't be written to: "):
        OutputLock(Path("/proc/self"), _no_warning)


def test_a_file_in_the_place_of_the_folder_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name, why in (
        ("file", "is a file, must be a folder"),
        ("file/out", "can't be made: Not a directory"),
    ):
        with (
            pytest.raises(InputError, match=f"^output .*: {why}$"),
            locked_folder(tmp_path / name, _no_warning),
        ):
            pass


def test_a_lock_released_while_another_is_waiting_for_the_file_is_not_held_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file that was opened is removed, and another made, before it is locked."""
    first, flock = OutputLock(tmp_path, _no_warning), fcntl.flock
    others: list[OutputLock] = []

    def between(handle: int, operation: int) -> None:
        monkeypatch.setattr(fcntl, "flock", flock)
        first.release()
        others.append(OutputLock(tmp_path, _no_warning))
        flock(handle, operation)

    monkeypatch.setattr(fcntl, "flock", between)
    with pytest.raises(InputError, match="is writing there"):
        OutputLock(tmp_path, _no_warning)
    others[0].release()


def test_of_many_at_once_one_has_the_folder(tmp_path: Path) -> None:
    held, refused = list[OutputLock](), list[str]()

    def lock() -> None:
        try:
            held.append(OutputLock(tmp_path, _no_warning))
        except InputError as error:
            refused.append(str(error))

    _at_once(16, lock)
    assert (len(held), len(refused)) == (1, 15)
    held[0].release()
    held[0].release()
    OutputLock(tmp_path, _no_warning).release()


def test_names_made_in_the_same_second_are_all_different(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made = list[Path]()
    _at_once(16, lambda: made.append(new_folder("elliptic-20260101-120000")))
    assert len(set(made)) == 16
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {path.name for path in made}


def _at_once(number: int, do: Callable[[], None]) -> None:
    barrier = threading.Barrier(number)

    def one() -> None:
        barrier.wait()
        do()

    threads = [threading.Thread(target=one) for _ in range(number)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
