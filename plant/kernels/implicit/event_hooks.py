"""Hooks for events within a step: only what an effect leaves to be captured is compiled with it.

Where wheels differ from the exact solver's, the motion along a captured surface is stepped (``sliding``) or not
captured: below a tall parcel (``transfer``), and on wheels with a width (``edges``), whose supports change without a
jump.
"""

from __future__ import annotations

from typing import Final

UNCAPTURED: Final = ("springs", "factors", "drag", "stiction", "transfer", "edges")
"""Parts of a surface with which the motion along a captured surface has no series."""


def follow_captures(surface, parcel, work, now, left, events):
    """A step along captured surfaces, if there are any. Returns (status, seconds, attempts: 0 if there are none)."""
