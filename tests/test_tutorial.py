"""docs/tutorial.md is followed as it stands: its files written, its commands run, what they print compared."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from itertools import accumulate
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "tutorial.md").read_text(encoding="utf-8")
CHAPTERS = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
FILE = re.compile(r"```(?:toml|python)\n# (\S+)\n(.*?)```", re.DOTALL)
COMMAND = re.compile(r"^    mdms (.+)\n(?:\n((?:    .+\n)+))?", re.MULTILINE)
NUMBER = re.compile(r"-?\d+\.\d+")
LAST_PLACES = 2e-6
"""Of a printed number, for machines that round differently."""

FILES = list(
    accumulate((dict(FILE.findall(chapter)) for chapter in CHAPTERS), lambda before, more: before | more)
)
"""By chapter: what the reader has written by then."""
RUNS = [
    pytest.param(number, command, said, id=f"{chapter.split('.')[0]}: {command[:60]}")
    for number, chapter in enumerate(CHAPTERS)
    for command, said in COMMAND.findall(chapter)
    if "--processes each" not in command  # tests/system runs others so; a hundred processes take their time
]


def _mdms(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    program = "import sys; from deploy.cli import main; sys.exit(main())"
    words = [*shlex.split(command), "--no-picture", "--output", "run"]
    return subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


def _written(number: int, folder: Path) -> Path:
    for name, text in FILES[number].items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def test_the_page_writes_three_programs_and_runs_them() -> None:
    assert set(FILES[-1]) == {"turn.toml", "turn.py", "turn_arrays.py"}
    assert len(RUNS) == 9


def test_an_empty_file_is_refused_as_the_page_says(tmp_path: Path) -> None:
    (_written(0, tmp_path) / "turn.py").touch()
    done = _mdms("run turn.toml", tmp_path)
    assert done.returncode == 2
    assert done.stderr.strip().replace(str(tmp_path), "…") in PAGE


@pytest.mark.slow
@pytest.mark.parametrize(("number", "command", "said"), RUNS)
def test_a_command_of_the_page_prints_what_it_says(
    number: int, command: str, said: str, tmp_path: Path
) -> None:
    done = _mdms(command, _written(number, tmp_path))
    assert done.returncode == 0, done.stderr
    printed = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert said
    for line in (" ".join(line.split()) for line in said.splitlines()):
        alike = [other for other in printed if NUMBER.sub("#", other).startswith(NUMBER.sub("#", line))]
        assert alike, (line, printed)
        found, told = NUMBER.findall(alike[0]), NUMBER.findall(line)
        for one, other in zip(found, told, strict=False):
            assert float(one) == pytest.approx(float(other), abs=LAST_PLACES)
