"""``mdms check`` as users call it: coverage, counterexample, exit status, and values that are refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy import cli

MUTANTS = "tests.deploy.studies.adversary.mutants"
GOALS = "goals=[{ cell = [0, 0] }]"


def test_the_bundled_hop_gradient_holds_in_small_worlds(capsys: pytest.CaptureFixture[str]) -> None:
    options = [
        "--set",
        GOALS,
        "--set",
        "limit=6",
        "--kinds",
        "loss,delay,death,repair,outage",
        "--depth",
        "8",
    ]
    assert cli.main(["check", "hop_gradient", "--world", "1x3", "--world", "2x2", *options, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "ok"
    assert [(row["world"], row["unexplored"], row["limit"]) for row in found["worlds"]] == [
        ("1x3", 0, None),
        ("2x2", 0, None),
    ]
    assert found["worlds"][1]["states"] > 100


def test_counters_begin_near_their_wraps_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "found.toml")
    options = ["--world", "1x3", "--depth", "16", "--kinds", "loss", "--output", file]
    assert cli.main(["check", f"{MUTANTS}:SerialWords", *options]) == 0
    said = capsys.readouterr().out
    assert [line.partition(":")[0] for line in said.splitlines()] == ["1x3", "1x3 from version=65534"]
    assert cli.main(["check", f"{MUTANTS}:PlainWords", *options]) == 1
    said = capsys.readouterr()
    assert "1x3 from version=65534: " in said.out
    assert f"counterexample: {file}; mdms run {file} --check repeats it" in said.err
    assert "version = 65534" in Path(file).read_text(encoding="utf-8")
    chart = Path(file).with_suffix(".png")
    assert f"its messages: {chart}" in said.err
    assert chart.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--world", "2"], "--world 2: must be ROWSxCOLUMNS, such as 2x2"),
        (["--cover", "9,9"], "--cover 9,9: the world 1x2 has no such cell"),
        (["--at-most", "loss"], "--at-most loss: must be KIND=N, such as death=1"),
        (["--kinds", "loss,lie"], "kind 'lie': must be one of loss, delay, death, repair, outage"),
        (["--set", "goal=1"], "cells.parameters.goal"),
        (["--output", "nowhere/found.toml"], "--output nowhere/found.toml: there is no folder nowhere"),
    ],
)
def test_bad_input_is_refused_with_status_2(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", f"{MUTANTS}:Tree", *options]) == 2
    assert says in capsys.readouterr().err


def test_a_program_without_conditions_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "wave"]) == 2
    assert "the program wave has no conditions to check" in capsys.readouterr().err
