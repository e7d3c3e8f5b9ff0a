"""Code and commands of docs/protocols/kit.md: they print what the page says, and find no violation."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from deploy import cli
from deploy.studies.adversary.check import check_exhaustively, world_scene
from deploy.studies.adversary.spec import Adversary
from mdms import kit

PAGE = (Path(__file__).parents[1] / "docs" / "protocols" / "kit.md").read_text(encoding="utf-8")
PROGRAM, EXAMPLE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = re.findall(r"^    mdms (check .*)$", PAGE, re.MULTILINE)


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = PROGRAM.splitlines()[0].removeprefix("# ")
    (tmp_path / name).write_text(PROGRAM, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return name


def test_the_example_prints_what_the_page_says(program: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(EXAMPLE, "docs/protocols/kit.md", "exec"), {})
    said = re.findall(r"print\(.*\)  # (.*)$", EXAMPLE, re.MULTILINE)
    assert len(said) == 2
    assert capsys.readouterr().out.splitlines() == said


def test_the_example_holds_in_a_small_world(program: str) -> None:
    result, counterexample = check_exhaustively(
        world_scene(program, (1, 2)), Adversary(1, 4, ("loss", "death"))
    )
    assert counterexample is None
    assert not result.limit


def test_the_page_names_every_function_of_the_kit() -> None:
    table = PAGE.partition("| piece |")[2].partition("\n\n")[0]
    functions = {name for name in kit.__all__ if callable(getattr(kit, name))}
    assert functions == set(re.findall(r"`(\w+)`", table)) - {
        "spanning_tree",
        "push_sum",
        "distance2_slots",
        "synchroniser",
    }


@pytest.mark.slow
@pytest.mark.timeout(240)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_search_of_the_page_finds_nothing_and_is_complete(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    # with one fault: two take minutes
    words = shlex.split(command)
    words[words.index("--faults") + 1] = "1"
    assert cli.main(words) == 0
    for line in capsys.readouterr().out.splitlines():
        assert line.endswith("no violation, nothing cut off"), line
