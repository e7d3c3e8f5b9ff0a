"""``mdms warm``: kernels compiled ahead, side by side, and an end by Ctrl-C that leaves nothing behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deploy import cli

ROOT = Path(__file__).parents[3]


def test_what_is_compiled_is_loaded(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["warm", "elliptic", "--json"]) == 0
    capsys.readouterr()
    assert cli.main(["warm", "elliptic", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["compiled"] == {"elliptic": 0}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["eliptic"], "elliptic"),
        (["elliptic", "--processes", "0"], "--processes 0"),
        (["elliptic", "--solver", "implicit"], "--solver implicit: no scene has it"),
    ],
)
def test_bad_input_compiles_nothing(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["warm", *arguments]) == 2
    assert message in capsys.readouterr().err


def _warm(*arguments: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "deploy.cli", "warm", *arguments],
        cwd=ROOT,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_several_scenes_are_compiled_in_processes_of_their_own() -> None:
    process = _warm("elliptic", "coulomb", "--processes", "2")
    stdout, stderr = process.communicate(timeout=110)
    assert process.returncode == 0, stderr
    assert "for 2 scenes" in stdout
    assert "2 of 2" in stderr


def _children(pid: int) -> list[int]:
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


@pytest.mark.slow
def test_ctrl_c_ends_the_compilers_too(tmp_path: Path) -> None:
    process = _warm("elliptic", "coulomb", NUMBA_CACHE_DIR=str(tmp_path))
    deadline = time.monotonic() + 60
    while not (children := _children(process.pid)):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 130
    assert stderr.splitlines()[-1] == "mdms: interrupted"
    assert not any(Path(f"/proc/{child}").exists() for child in children)
