"""Ctrl-C and SIGTERM from the first import on end a command in one line and with status 130."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deploy import cli
from deploy.commands import application as command_line

ROOT = Path(__file__).parents[3]
SIGNALS = [signal.SIGINT, signal.SIGTERM]

AT_AN_IMPORT = """
import os, sys
class Bell:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            os.kill(os.getpid(), {number:d})
sys.meta_path.insert(0, Bell())
from deploy.cli import main
sys.exit(main(["scenes"]))
"""


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("module", ["typer", "deploy.commands.scenes", "pydantic", "rich.table"])
def test_a_signal_while_modules_are_imported_is_one_line(module: str, number: signal.Signals) -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_AN_IMPORT.format(module=module, number=number)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "mdms: interrupted\n")


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_in_the_middle_of_a_command_is_one_line(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        os.kill(os.getpid(), number)
        pytest.fail("the command went on")

    monkeypatch.setattr(command_line, "_function", lambda name: command)
    assert cli.main(["scenes"]) == 130
    assert tuple(capsys.readouterr()) == ("", "mdms: interrupted\n")


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    assert cli.main(["--version"]) == 0
    assert [signal.getsignal(number) for number in SIGNALS] == before
