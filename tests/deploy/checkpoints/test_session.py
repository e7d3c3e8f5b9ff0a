"""What of a run is kept, and what goes on from it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, cast

import pytest

from bus.state import StateFields, save_state
from deploy.checkpoints.checkpointer import checkpoint_metadata, make_checkpointer, restore_run
from deploy.errors import InputError
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions, plan
from tests.deploy.checkpoints.test_store import CHECKPOINT


class Part:
    """Something of a run that remembers a number."""

    state_fields: ClassVar[StateFields] = StateFields("value")

    def __init__(self, value: Any = 0) -> None:
        self.value, self.shown = value, list[int]()

    def show(self, events: int) -> None:
        """Of the ledger."""
        self.shown.append(events)


@pytest.mark.parametrize(("recorded", "events"), [({}, 0), ({"/events": 4, "/tick": 7}, 4)])
@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize("asked", [True, False])
def test_all_of_the_plant_s_process_is_as_it_was(
    asked: bool, kept: bool, recorded: dict[str, int], events: int
) -> None:
    checkpoint = replace(
        CHECKPOINT,
        process=save_state(Part(1)),
        ledger=save_state(Part(2)),
        reporter=save_state(Part(3)) if kept else None,
        recorded=recorded,
    )
    process, ledger, reporter = Part(), Part(), Part()
    restore_run(
        checkpoint, cast("Any", process), cast("Any", ledger), cast("Any", reporter if asked else None)
    )
    assert (process.value, ledger.value, reporter.value) == (1, 2, 3 if asked and kept else 0)
    assert ledger.shown == [events]


def test_a_plant_that_can_not_be_kept_is_said_before_anything_starts() -> None:
    scene, options = load_scene("elliptic"), RunOptions(checkpoint_s=1.0)
    stranger = cast("Any", Part(object()))
    with pytest.raises(
        InputError, match="--checkpoint: the plant's state can't be saved: state holds a builtins"
    ):
        checkpoint_metadata(scene, plan(scene, options, "RUN"), options, stranger, None, live=False)
    options = RunOptions()
    assert (
        checkpoint_metadata(scene, plan(scene, options, "RUN"), options, stranger, None, live=False) is None
    )
    nothing = cast("Any", None)
    assert make_checkpointer(None, options, nothing, nothing, nothing, None, None, 1.0) is None
