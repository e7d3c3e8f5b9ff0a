"""Errors of the plant."""

from __future__ import annotations


class PlantError(Exception):
    """The plant refuses what it was given; the text names the field, the rule and the value."""
