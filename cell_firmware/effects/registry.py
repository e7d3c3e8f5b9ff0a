"""Every effect of the cells: a new one is a file and a line here."""

from __future__ import annotations

from bus.effect import Effects


class CellEffects(Effects):
    """Effects on what cells sense, compute and tell each other that a scene asks for."""
