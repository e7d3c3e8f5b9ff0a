"""Errors of the plant."""

from __future__ import annotations


class PlantError(Exception):
    """The plant refuses what it was given; the text names the field, the rule and the value."""


class PlantUnstable(PlantError):
    """The motion can't be followed any further; the text says which parcel, where, when and why."""
