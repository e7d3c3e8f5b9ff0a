"""Replay of a recorded run, with the recorded live commands and losses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from pydantic import ConfigDict, TypeAdapter

from bus.fault import decode_fault
from deploy.errors import InputError
from deploy.faults.registry import Fault

if TYPE_CHECKING:
    from bus.fault import FaultInstance, FaultSpec
    from deploy.recordings.recording import Recording
    from deploy.scenes.scene import Scene

LOSS: Final = "loss"
"""Kind of the command that stands for cells found lost."""
REPLAYED: Final = ("fault", "repair", "move", LOSS)
"""Kinds of live commands that change what is simulated."""
FOUND: Final = ("disconnected", "timed_out")
"""Losses that don't recur independently when the run is repeated."""
_FIRST_NUMBER: Final = 1_000_000
"""Number of the first fault that stands for losses, above the numbers of scheduled and live faults."""
_FAULTS: Final[TypeAdapter[Any]] = TypeAdapter(Fault, config=ConfigDict(defer_build=True))


def commands_of(recording: Recording, scene: Scene) -> tuple[Mapping[str, Any], ...]:
    """Return the live commands of a recorded run, and a crash for every lost cell.

    Raises:
        InputError: The recording is of another scene, or has commands that can't be decoded.
    """
    theirs, ours = dict(recording.header["scene"]), scene.model_dump(mode="json")
    # words, and limits on the wall clock, may differ
    for described in (theirs, ours):
        described["stall"] = {"policy": described["stall"]["policy"]}
    differs = [key for key in ours if key != "title" and theirs.get(key) != ours[key]]
    if differs:
        raise InputError(
            f"--replay: the recording is of another scene than {scene.name}: {', '.join(differs)} differ; "
            "give the recorded scene, with its --set, --seed and --duration"
        )
    commands = (record for record in recording.control if record["kind"] in REPLAYED)
    script = (*commands, *_losses(recording.faults))
    for record in script:
        try:
            _check(record, scene)
        except (LookupError, TypeError, ValueError) as error:
            raise InputError(
                f"--replay: the recording's command {record} can't be replayed: {error}"
            ) from None
    return script


def decode_command(detail: Mapping[str, Any], scene: Scene) -> FaultInstance[FaultSpec]:
    """Decode a recorded fault.

    Raises:
        ValueError: The detail is no fault, or names cells outside this scene's array.
    """
    return decode_fault(detail, _FAULTS, scene.lattice(), scene.seed)


def _check(record: Mapping[str, Any], scene: Scene) -> None:
    """Check that a command can be decoded; errors of any type mean that decoding failed."""
    int(record["tick"])
    if record["kind"] == "repair":
        int(record["detail"]["number"])
    elif record["kind"] == "move":
        int(record["detail"]["parcel"])
        if not all(math.isfinite(value) for value in record["detail"]["pose"]):
            raise ValueError("a pose must be finite")
    else:
        decode_command(record["detail"], scene)


def _losses(faults: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Turn losses into crash faults, one for all cells that were lost, and rejoined, in the same ticks."""
    lost: dict[tuple[int, int | None], list[list[int]]] = {}
    for i, fault in enumerate(faults):
        if fault["kind"] in FOUND:
            key = int(fault["tick"]), _back(fault["cell"], faults[i:])
            lost.setdefault(key, []).append(fault["cell"])
    return [
        {
            "kind": LOSS,
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
    """Return the tick in which a cell rejoined; None if the cell never did."""
    return next((int(f["tick"]) for f in faults if f["kind"] == "respawn" and cell in f["cells"]), None)
