"""What was done to a run while it went on, and whom it lost, from its recording: so that it can be repeated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from deploy.errors import InputError

if TYPE_CHECKING:
    from deploy.recordings.reader import Recording
    from deploy.scenes.scene import Scene

FOUND: Final = ("token_lost", "stalled")
"""Losses that the run can't come to by itself when it is repeated."""
_FIRST_NUMBER: Final = 1_000_000
"""Of faults that stand for losses: beyond those of scenes and operators."""


def commands_of(recording: Recording, scene: Scene) -> tuple[Mapping[str, Any], ...]:
    """The live commands of a recorded run, and a crash for every cell that it lost, by tick.

    Raises:
        InputError: The recording is of another scene, or has commands that no run carries out.
    """
    theirs, ours = dict(recording.header["scene"]), scene.model_dump(mode="json")
    # words, and limits on the wall clock, may differ
    for described in (theirs, ours):
        described["stall"] = {"policy": described["stall"]["policy"]}
    differs = [key for key in ours if key != "title" and theirs.get(key) != ours[key]]
    if differs:
        raise InputError(
            f"--replay: the recording is of another scene than {scene.name}: {', '.join(differs)} differ; "
            "give the scene as it was, with its --set, --seed and --duration"
        )
    script = (*recording.control, *_losses(recording.faults))
    for record in script:
        try:
            _check(record, scene)
        except (LookupError, TypeError, ValueError) as error:
            raise InputError(
                f"--replay: the recording's command {record} can't be repeated: {error}"
            ) from None
    return script


def _check(record: Mapping[str, Any], scene: Scene) -> None:
    """Looks whether a command can be read; raises whatever error says that it can't."""
    from deploy.control.protocol import decode_fault

    int(record["tick"])
    if record["kind"] == "repair":
        int(record["detail"]["number"])
    else:
        decode_fault(record["detail"], scene)


def _losses(faults: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Cells that were lost in the same tick die of one fault."""
    lost: dict[tuple[int, int | None], list[list[int]]] = {}
    for i, fault in enumerate(faults):
        if fault["kind"] in FOUND:
            key = int(fault["tick"]), _back(fault["cell"], faults[i:])
            lost.setdefault(key, []).append(fault["cell"])
    return [
        {
            "kind": "fault",
            "tick": tick,
            "detail": {
                "number": _FIRST_NUMBER + i,
                "fault": {"kind": "crash", "cells": cells},
                "first": tick,
                "end": end,
            },
        }
        for i, ((tick, end), cells) in enumerate(lost.items())
    ]


def _back(cell: list[int], faults: Sequence[Mapping[str, Any]]) -> int | None:
    """The tick from which a cell took part again; None: it never did."""
    return next((int(f["tick"]) for f in faults if f["kind"] == "respawn" and cell in f["cells"]), None)
