"""What the help of commands shows of brackets: Rich takes them for markup."""

from __future__ import annotations

import pytest

from deploy.cli import main


def test_a_section_of_a_scene_is_shown_with_its_brackets(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["campaign", "--help"]) == 0
    assert " ".join(capsys.readouterr().out.split()).count("[goal]") == 2
