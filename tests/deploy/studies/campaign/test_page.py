"""The commands of the page and of the help ask for campaigns that there can be."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from deploy.cli import main
from deploy.commands.campaign import campaign
from deploy.studies.campaign.cases import cases_of
from deploy.studies.campaign.spec import CampaignSpec

PAGE = (Path(__file__).resolve().parents[4] / "docs" / "campaigns.md").read_text(encoding="utf-8")
COMMANDS = [
    command
    for command in re.findall(
        r"mdms (campaign (?!--resume)[^\[\n]+ --[^\[\n]+)", PAGE + (campaign.__doc__ or "")
    )
    if "DIR" not in command
]


@pytest.mark.parametrize("command", sorted(set(COMMANDS)))
def test_the_command_is_understood_and_its_scenes_are_valid(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[int] = []

    def only_plan(spec: CampaignSpec, text: str, *_: Any, **__: Any) -> None:
        found.append(cases_of(spec, text).runs)
        raise typer.Exit(0)

    monkeypatch.setattr("deploy.commands.campaign._run", only_plan)
    assert main(shlex.split(command)) == 0
    assert found[0] > 1


def test_there_are_such_commands() -> None:
    assert len(COMMANDS) >= 6
