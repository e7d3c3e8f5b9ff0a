"""Entry point of the command line."""

from __future__ import annotations

import gc
from collections.abc import Sequence

import pytest

from deploy import cli


def test_garbage_is_collected_seldom_during_a_command_and_as_before_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = gc.get_threshold()
    during: list[tuple[int, int, int]] = []

    def run(arguments: Sequence[str]) -> int:
        during.append(gc.get_threshold())
        return 0

    monkeypatch.setattr(cli, "_run", run)
    assert cli.main([]) == 0
    assert during[0][0] > 10 * before[0]
    assert gc.get_threshold() == before
