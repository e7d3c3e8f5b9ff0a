"""Runs that are killed at a given call that changes what is on the disk, in forks of one process.

The calls are those of Python's ``os`` and ``io``: opening to write, writing, syncing, renaming, removing, locking. A
write counts twice: before it, and with half of it written. Between two such calls a kill leaves the same files.
"""

from __future__ import annotations

import fcntl
import io
import itertools
import json
import os
import re
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from deploy import cli
from deploy.checkpoints.checkpointer import Checkpointer
from deploy.checkpoints.store import NAMES

STEP_S = 0.01
"""What a keeper's clock goes on by whenever it is looked at: checkpoints come at ticks, not at wall times."""
EVERY_S = 0.2
_STILL = ("--no-picture", "--json", "--quiet")


class Ended(NamedTuple):
    """How a process ended: its exit status, or minus the signal's number; stdout and stderr."""

    status: int
    out: str
    error: str


@dataclass
class Case:
    """A kill, and what came of its run.

    Attributes:
        kind: What was killed: ``new``, ``again`` in the folder of a run that was killed, or ``resume``.
        call: The number of the call, from 1.
        killed: Whether it came so far; a run that did not is over.
        name: Of the call, and the file.
        checkpoint: Whether the kill left a file of a checkpoint.
        refused: The line with which the run was refused to go on.
        digest: What it came to in the end.
    """

    kind: str
    call: int
    killed: bool
    name: str = ""
    checkpoint: bool = False
    refused: str = ""
    digest: str = ""


class _Calls:
    """Counts calls, and kills the process at one of them; notes the call in a file."""

    def __init__(self, at: int, note: int) -> None:
        self.at, self.note = at, note
        self.count = 0

    def __call__(self, name: str) -> None:
        self.count += 1
        if self.count == self.at:
            _WRITE(self.note, name.encode())
            os.kill(os.getpid(), signal.SIGKILL)


_WRITE = os.write


def _install(calls: _Calls) -> None:
    """Let this process count its calls from now on."""

    class Counted(io.FileIO):
        def write(self, data: Any) -> int:
            name, view = Path(str(self.name)).name, memoryview(data).cast("B")
            calls(f"write {name}")
            half = len(view) // 2
            if half:
                super().write(view[:half])
                calls(f"half a write {name}")
            return half + (super().write(view[half:]) or 0)

    def opened(file: Any, mode: str = "r", *others: Any, **named: Any) -> Any:
        if not set(mode) & set("wax+") or not isinstance(file, str | Path):
            return plain(file, mode, *others, **named)
        calls(f"open {Path(file).name}")
        buffered = io.BufferedWriter(Counted(file, mode.replace("b", "").replace("t", "")))
        return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding="utf-8", write_through=True)

    plain, io.open = io.open, opened
    for module, name in (
        (os, "open"),
        (os, "replace"),
        (os, "rename"),
        (os, "unlink"),
        (os, "mkdir"),
        (os, "fsync"),
        (os, "ftruncate"),
        (os, "pwrite"),
        (fcntl, "flock"),
    ):
        setattr(module, name, _counted(getattr(module, name), name, calls))


def _counted(function: Callable[..., Any], name: str, calls: _Calls) -> Callable[..., Any]:
    def counted(*arguments: Any, **named: Any) -> Any:
        of = arguments[0] if isinstance(arguments[0], str | Path) else f"/proc/self/fd/{arguments[0]}"
        calls(f"{name} {Path(os.path.realpath(of)).name}")
        return function(*arguments, **named)

    return counted


def forked(arguments: list[str], scratch: Path, at: int = 0) -> tuple[Ended, str]:
    """Carry out a command in a fork of this process, killed at a call.

    Returns:
        How it ended, and the call's name, or the number of all calls where it was not killed.
    """
    files = [scratch / name for name in ("stdout", "stderr", "note")]
    handles = [os.open(file, os.O_RDWR | os.O_CREAT | os.O_TRUNC) for file in files]
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.dup2(handles[0], 1)
            os.dup2(handles[1], 2)
            calls = _Calls(at, handles[2])
            _install(calls)
            status = cli.main(arguments)
            _WRITE(handles[2], str(calls.count).encode())
        except BaseException:  # noqa: BLE001 - a fork must not go on as the process that it was forked from
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    for handle in handles:
        os.close(handle)
    _, status = os.waitpid(child, 0)
    out, error, note = (file.read_text() for file in files)
    return Ended(os.waitstatus_to_exitcode(status), out, error), note


class Sweep:
    """Kills runs of a scene call by call.

    Args:
        scene: The scene's file.
        scratch: Folder to work in.

    Attributes:
        digest: Of the run that nobody killed.
    """

    def __init__(self, scene: Path, scratch: Path) -> None:
        assert Checkpointer.__init__.__kwdefaults__ is not None
        ticks = itertools.count()
        Checkpointer.__init__.__kwdefaults__["clock"] = lambda: next(ticks) * STEP_S
        self._scratch, self._folder = scratch, scratch / "out"
        self._new = [
            *("run", str(scene), "--processes", "0", "--transport", "memory", *_STILL),
            *("--checkpoint", str(EVERY_S), "--output", str(self._folder)),
        ]
        self._resume = ["run", "--resume", str(self._folder), *_STILL]
        # Here, not in a fork: forks then have all modules and kernels.
        stdout, sys.stdout = sys.stdout, io.StringIO()
        assert cli.main(self._new) == 0
        self.digest: str = json.loads(sys.stdout.getvalue())["digest"]
        sys.stdout = stdout
        self._left = scratch / "left"
        self._kept()

    def _kept(self) -> None:
        """Keep the folder of a run that was killed with two checkpoints in it."""
        for call in itertools.count(35, 3):
            shutil.rmtree(self._folder)
            # Slowly: the thread that writes checkpoints is to keep up with the ticks.
            ended, _ = forked([*self._new, "--realtime", "0.25"], self._scratch, call)
            assert ended.status == -signal.SIGKILL, "the run was over before it had two checkpoints"
            if all((self._folder / name).exists() for name in NAMES[:2]):
                break
        shutil.copytree(self._folder, self._left)

    def _laid_out(self, kind: str) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        if kind != "new":
            shutil.copytree(self._left, self._folder)

    def case(self, kind: str, call: int) -> Case:
        """Kill at one call, and go on to the end."""
        self._laid_out(kind)
        ended, name = forked(self._resume if kind == "resume" else self._new, self._scratch, call)
        case = Case(kind, call, ended.status == -signal.SIGKILL, name)
        if case.killed:
            case.checkpoint = any((self._folder / name).exists() for name in NAMES[:2])
            ended, _ = forked(self._resume, self._scratch)
        if ended.status == 0:
            case.digest = json.loads(ended.out)["digest"]
            _assert_whole(self._folder, case.digest)
        else:
            assert (ended.status, ended.out) == (2, ""), f"{case}: {ended}"
            case.refused = ended.error
            if re.search("the run is over, with status ok", ended.error):
                case.digest = json.loads((self._folder / "summary.json").read_text())["digest"]
                _assert_whole(self._folder, case.digest)
        return case

    def calls(self, kind: str) -> int:
        """How many calls a run of that kind makes; some more or less, as its threads have it."""
        self._laid_out(kind)
        _, number = forked(self._resume if kind == "resume" else self._new, self._scratch)
        return int(number)


def _assert_whole(folder: Path, digest: str) -> None:
    """No tick is missing in the recording, or there twice."""
    from deploy.recordings.reader import load

    recording = load(folder)
    assert recording.tick.tolist() == list(range(len(recording.tick)))
    assert (recording.status, recording.digest) == ("ok", digest)


def main() -> None:
    """``SCENE SCRATCH KIND SHARE,...|all``: a line of JSON a kill, after the digest of the run that nobody killed.

    A share is that of the calls of such a run, from 0 to 1.
    """
    sweep = Sweep(Path(sys.argv[1]), Path(sys.argv[2]))
    print(json.dumps(sweep.digest), flush=True)
    for kind, wanted in zip(sys.argv[3::2], sys.argv[4::2], strict=True):
        calls = sweep.calls(kind)
        chosen = (1 + int(float(share) * calls) for share in wanted.split(",") if share != "all")
        for call in itertools.count(1) if wanted == "all" else chosen:
            case = sweep.case(kind, call)
            print(json.dumps(asdict(case)), flush=True)
            if wanted == "all" and not case.killed:
                break


if __name__ == "__main__":
    main()
