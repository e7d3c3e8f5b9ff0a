"""Code and commands of docs/lab.md are run as they stand, in one folder, and print what the page says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from deploy import cli

PAGE = (Path(__file__).parents[1] / "docs" / "lab.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
FILES = {code.splitlines()[0].removeprefix("# "): code for code in BLOCKS if code.startswith("# ")}
SAID = re.compile(r"print\(.*\)  # (.*)$", re.MULTILINE)
COMMANDS = re.findall(r"^    mdms (check .*|run .*)$", PAGE, re.MULTILINE)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, code in FILES.items():
        (tmp_path / name).write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("code", [code for code in BLOCKS if not code.startswith("# ")])
def test_an_example_prints_what_the_page_says(
    code: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exec(compile(code, "docs/lab.md", "exec"), {})
    assert capsys.readouterr().out.splitlines() == SAID.findall(code)


def test_the_commands_find_the_mistake_repeat_it_and_find_none_in_the_repaired_program(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(COMMANDS) == 4
    status: list[int] = []
    for command in COMMANDS:
        memory = ["--processes", "0", "--transport", "memory", "--no-picture", "-q"]
        more = [*memory, "--output", "out"] if command.startswith("run") else []
        status.append(cli.main([*shlex.split(command), *more]))
    said = capsys.readouterr()
    assert status == [1, 0, 1, 0], said
    assert "at most 1 fault (loss, delay, death, repair): BROKEN: tick 19: 'the root of each cell" in said.out
    assert "mdms: failed: tick 19: 'the root of each cell is alive' hasn't come true in time" in said.err
    assert said.out.rstrip().endswith("no violation, nothing cut off")
