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
        """Of the run log."""
        self.shown.append(events)


@pytest.mark.parametrize(("recorded", "events"), [({}, 0), ({"/events": 4, "/tick": 7}, 4)])
@pytest.mark.parametrize("stored", [True, False])
@pytest.mark.parametrize("requested", [True, False])
def test_all_of_the_plant_s_process_is_as_it_was(
    requested: bool, stored: bool, recorded: dict[str, int], events: int
) -> None:
    checkpoint = replace(
        CHECKPOINT,
        process=save_state(Part(1)),
        run_log=save_state(Part(2)),
        reporter=save_state(Part(3)) if stored else None,
        recorded=recorded,
    )
    process, run_log, reporter = Part(), Part(), Part()
    restore_run(
        checkpoint, cast("Any", process), cast("Any", run_log), cast("Any", reporter if requested else None)
    )
    assert (process.value, run_log.value, reporter.value) == (1, 2, 3 if requested and stored else 0)
    assert run_log.shown == [events]


def test_a_plant_that_cannot_be_saved_is_refused_before_anything_starts() -> None:
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
