"""Records of a program in scalar form: what its step reads and writes in a control period of one cell."""

from __future__ import annotations

from typing import Any

import numpy as np

from cell_firmware.message_drafts import array_draft, compiled_draft

MOST_SENSORS = 5
"""Most presence sensors of a cell."""
NO_MESSAGE = np.dtype([("none", "u1")])
"""Type in place of the messages of a program that has none."""


def inputs_type(message: np.dtype[Any], random: tuple[str, ...] = ()) -> np.dtype[Any]:
    """Return the type of a step's inputs, for a type of messages; truth values are bytes, 0 or 1.

    ``sensors`` says how many of ``presence`` and ``level`` there are; ``level`` and ``label`` are zero in a scene
    without analogue sensors and scanners. Sides are in the order north, east, south, west. ``random`` is a record of
    the random numbers by name, and absent for a program that declares none.
    """
    return np.dtype(
        [
            ("message", message, (4,)),
            *([("random", [(name, "<f8") for name in random])] if random else ()),
            ("sensors", "<i8"),
            ("level", "<f8", (MOST_SENSORS,)),
            ("label", "<i8"),
            ("presence", "u1", (MOST_SENSORS,)),
            ("received", "u1", (4,)),
        ],
        align=True,
    )


def outputs_type(message: np.dtype[Any], *, compiled: bool = True) -> np.dtype[Any]:
    """Return the type of a step's outputs, which are zero before it, but for ``served``, which is 1.

    Args:
        message: Type of the messages.
        compiled: Whether messages are drafts of a compiled step (``compiled_draft``), not in Python (``array_draft``).
    """
    draft = compiled_draft(message) if compiled else array_draft(message)
    return np.dtype(
        [("speed_m_s", "<f8", (2,)), ("served", "u1"), ("sent", "u1", (4,)), ("message", draft, (4,))],
        align=True,
    )
