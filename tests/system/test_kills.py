"""Killed at any call of the operating system, a run can be resumed to its digest, or has no checkpoint yet."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.system.cut_off import Case
from tests.system.running import ROOT
from tests.system.small import small_scene

pytestmark = pytest.mark.slow

KINDS = {"new": 6, "again": 4, "resume": 10}
"""How many of each the ordinary tests kill."""


def _cases(folder: Path, *wanted: str) -> Iterator[tuple[Case, str]]:
    """Kills as ``tests.system.cut_off`` makes them, each with the digest of the run that nobody killed."""
    (folder / "small.toml").write_text(small_scene())
    done = subprocess.run(
        [sys.executable, "-m", "tests.system.cut_off", str(folder / "small.toml"), str(folder), *wanted],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    digest, *cases = map(json.loads, done.stdout.splitlines())
    for case in cases:
        yield Case(**case), digest


def _assert_resumed_or_refused(case: Case, digest: str) -> None:
    if case.digest:
        assert case.digest == digest, case
        return
    assert (case.kind, case.checkpoint) in (("new", False), ("again", False)), case
    assert case.refused.count("\n") == 1, case
    assert "there is no checkpoint in" in case.refused or "there is no such folder" in case.refused, case


def test_twenty_kills_at_calls_over_start_resume_checkpoint_and_end(tmp_path: Path) -> None:
    draw = np.random.default_rng(17)
    wanted = list[str]()
    for kind, number in KINDS.items():
        # One in each of as many equal parts of the run: from its start to its end, checkpoints in between.
        shares = (np.arange(number) + draw.random(number)) / number
        wanted += [kind, ",".join(f"{share:.4f}" for share in shares)]
    cases = list(_cases(tmp_path, *wanted))
    assert len(cases) == sum(KINDS.values())
    for case, digest in cases:
        _assert_resumed_or_refused(case, digest)
    assert {"new", "again", "resume"} == {case.kind for case, _ in cases if case.killed and case.digest}


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", KINDS)
def test_a_kill_at_every_call(kind: str, tmp_path: Path) -> None:
    cases = list(_cases(tmp_path, kind, "all"))
    for case, digest in cases:
        _assert_resumed_or_refused(case, digest)
    names = {case.name for case, _ in cases}
    assert {
        "fsync .checkpoint.msgpack.draft",
        "unlink checkpoint.msgpack",
        # a resumed recording keeps the name that it was opened under
        "half a write .recording.mcap.draft" if kind == "resume" else "half a write recording.mcap",
    } <= names
    assert ("replace .recording.mcap.draft" in names) == (kind == "resume")
