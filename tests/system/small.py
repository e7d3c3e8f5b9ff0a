"""A scene that is over in no time and uses everything: links, borders, a moving parcel."""

from __future__ import annotations

SMALL = """
title = "Cells that talk, a parcel between them"
duration_s = {duration_s}

[array]
rows = 3
columns = {columns}

[cells]
firmware = "heat_diffusion"
[cells.parameters]
diffusion_number = 0.2
held = [{{ cell = [1, 0], speed_m_s = [0.1, 0.0] }}]

[[parcels]]
size_m = [0.25, 0.15]
mass_kg = 1.0
position_m = [0.0, 0.0]

[friction]
law = "viscous"
coefficient_s_per_m = 0.2
"""


def small_scene(columns: int = 4, duration_s: float = 0.2) -> str:
    """The scene's text."""
    return SMALL.format(columns=columns, duration_s=duration_s)
