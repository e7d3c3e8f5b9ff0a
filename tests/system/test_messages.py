"""Messages between cells are recorded on request: alike for every partition, and without a change of the result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.errors import InputError
from deploy.recordings import run_log
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from tests.system.test_live import TICKS, scene


def recorded(folder: Path, **options: object) -> tuple[str, dict[str, np.ndarray], list[int]]:
    """The digest of a run, and what was recorded of its messages."""
    outcome = run(scene(), RunOptions(output=folder, picture=False, **options), quiet=True)  # pyright: ignore[reportArgumentType]
    assert outcome.summary.status == "ok"
    found = load(folder)
    return outcome.summary.digest, dict(found.messages), found.message_tick.tolist()


@pytest.mark.slow
def test_messages_are_those_that_cells_sent_whoever_computes_them(tmp_path: Path) -> None:
    plain, none, _ = recorded(tmp_path / "plain", processes=0)
    one = recorded(tmp_path / "one", processes=0, messages=1, registers=1)
    two = recorded(tmp_path / "two", processes=2, messages=1)
    each = recorded(tmp_path / "each", processes="each", messages=50)
    assert none == {}
    assert {one[0], two[0], each[0]} == {plain}
    assert one[2] == two[2] == list(range(TICKS))
    assert each[2] == [0, 50, 100]
    assert list(one[1]) == ["sent", "vx_m_s", "vy_m_s"]
    for name, values in one[1].items():
        np.testing.assert_array_equal(values, two[1][name])
        np.testing.assert_array_equal(values[::50], each[1][name])
    run_ = load(tmp_path / "one")
    assert not any(name.startswith("message.") for name in run_.registers)
    speed = run_.registers["firmware.speed_m_s"]
    has_neighbour = scene().lattice().neighbours >= 0
    assert one[1]["sent"].all(axis=0)[has_neighbour].all()
    for side in range(4):
        np.testing.assert_array_equal(one[1]["vx_m_s"][:, :, side], speed[:, :, 0])


@pytest.mark.slow
def test_no_more_is_recorded_than_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a_tick = 20 * 4 * (1 + 8 + 8)
    monkeypatch.setattr(run_log, "MESSAGES_LIMIT", 10 * a_tick + 1)
    _, messages, ticks = recorded(tmp_path / "run", processes=0, messages=1)
    assert ticks == list(range(10))
    assert sum(values.nbytes for values in messages.values()) == 10 * a_tick


def test_a_program_without_messages_has_none_to_record() -> None:
    with pytest.raises(InputError, match="--messages: the program of the cells sends no messages"):
        run(load_scene("elliptic"), RunOptions(messages=1, picture=False), quiet=True)
