"""Hooks for events within a step: only what an effect leaves to be located is compiled with it.

On wheels with a width (``edges``), whose supports change without a jump, no change is located. Where wheels differ from
the exact solver's, the motion along a captured surface is stepped (``sliding``) or, below a tall parcel (``transfer``),
not captured.
"""

from __future__ import annotations

from typing import Final

UNLOCATED: Final = ("edges",)
"""Parts of a surface with which no step ends at an event."""
UNCAPTURED: Final = ("springs", "factors", "drag", "stiction", "transfer")
"""Parts of a surface with which the motion along a captured surface has no series."""


def prepare_step(surface, parcel, work, now, events):
    """Loads where a step begins. Returns the status."""


def take_step(surface, parcel, work, now, left, events):
    """One step of at most ``left`` seconds. Returns (status, seconds, attempts)."""


def follow_captures(surface, parcel, work, now, left, events):
    """A step along captured surfaces, if there are any. Returns (status, seconds, attempts: 0 if there are none)."""
