"""Velocity fields: surface velocity as a function of position."""

from cell_firmware.fields.base import Field
from cell_firmware.fields.registry import FieldSpec

__all__ = ["Field", "FieldSpec"]
