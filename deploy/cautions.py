"""What a scene's firmware says will go wrong, asked before anything starts."""

from __future__ import annotations

import traceback
from typing import TYPE_CHECKING

from deploy.errors import InputError

if TYPE_CHECKING:
    from deploy.scene import Scene


def cautions_of(scene: Scene) -> tuple[str, ...]:
    """A line for each thing that will go wrong on the scene's array though nothing forbids it.

    Raises:
        InputError: The firmware raised when it was asked; with its traceback.
    """
    from cell_firmware.loader import load

    try:
        return tuple(load(scene.cells).cautions(scene.lattice()))
    except Exception as error:
        trace = traceback.format_exc().rstrip()
        raise InputError(
            f"scene {scene.name}: firmware {scene.cells.firmware!r} can't say what to be careful of:\n{trace}"
        ) from error
