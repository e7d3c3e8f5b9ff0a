"""The scene ``junction``, shortened: with the plant, cells and all messages."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

pytestmark = pytest.mark.slow


def test_parcels_are_sorted_to_their_exits_and_none_meets_another_though_cells_die(tmp_path: Path) -> None:
    """Among the dead are three of each feeder's four readers, the leaders of their tiles with them."""
    readers = [[4 * feeder + row, column] for feeder in range(4) for row, column in ((1, 1), (2, 1), (1, 2))]
    dying = [
        {"kind": "crash", "at_s": 2.0 + 0.5 * i, "cell": cell}
        for i, cell in enumerate([[5, 9], [2, 14], [10, 6], [13, 18]])
    ]
    dying += [{"kind": "crash", "at_s": 0.2, "cell": cell} for cell in readers]
    scene = load_scene("junction", [Override(("duration_s",), 14.0, ""), Override(("faults",), dying, "")])
    summary = run(scene, RunOptions(0, "memory", output=tmp_path, picture=False), quiet=True).summary
    assert summary.status == "ok"
    traffic = summary.feeders
    assert traffic is not None
    assert traffic.left >= 8
    assert all(leaving.misrouted == 0 for leaving in traffic.exits)
    assert traffic.waiting + traffic.there + traffic.left == 32
    kinds = [event["kind"] for event in load(tmp_path).events]
    assert kinds.count("left") == traffic.left
    assert not {"overlap", "tipped"} & set(kinds)
