"""Completion in the shell: commands, bundled scenes, kinds of faults, keys of a scene; and kinds in help."""

from __future__ import annotations

import pytest

from deploy.cli import main
from deploy.faults.registry import KINDS, gist


def _completed(line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What bash receives for the last word of a line."""
    monkeypatch.setenv("_MDMS_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
    assert main([]) == 0
    return capsys.readouterr().out.split()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("mdms ca", ["campaign"]),
        ("mdms run el", ["elliptic"]),
        ("mdms simulate sq", ["squeeze"]),
        ("mdms campaign mis", ["misaligned"]),
        ("mdms fault wheel_", ["wheel_stuck", "wheel_weak", "wheel_reversed", "wheel_runaway"]),
        ("mdms campaign elliptic --fault link_d", ["link_down", "link_delay", "link_duplicate"]),
        ("mdms run heat --set cells.pa", ["cells.parameters."]),
        ("mdms run heat --set cells.parameters.d", ["cells.parameters.diffusion_number="]),
        ("mdms run elliptic --set parcels.0.size", ["parcels.0.size_m="]),
        ("mdms run nowhere.toml --set dur", []),
        ("mdms run elliptic --real", ["--realtime"]),
    ],
)
def test_the_shell_receives_the_completions_of_the_last_word(
    line: str, words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _completed(line, monkeypatch, capsys) == words


def test_help_of_fault_has_a_line_on_every_kind(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["fault", "--help"]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for kind in KINDS:
        assert f"{kind} {gist(kind)}" in lines
        assert 10 < len(gist(kind)) < 60
