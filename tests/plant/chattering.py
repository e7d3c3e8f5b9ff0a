"""Scenes that chatter by construction, and their motion by Filippov's rule without the plant's kernels.

Seven cells: two columns of three draw the parcel on, and one ahead of its edge drives it back with more force than all
others together. So the parcel's edge is drawn to that cell from both sides, and stays there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from plant.friction.registry import FrictionSpec
from plant.plant import Plant
from tests.plant.scenes import Floats, parcel, solved

SPAN_S = 0.2
PITCH_M = 0.1
SIZE_M = (0.26, 0.26)
AHEAD = 2
"""Column of the cell that drives back."""


def make_chattering(
    seed: int,
    solver: dict[str, Any],
    law: FrictionSpec,
    effects: Mapping[str, object] | None = None,
    *,
    volts: float = 1.0,
    off_m: float = 1e-9,
    **values: object,
) -> tuple[Plant, Floats]:
    """A parcel at rest within ``off_m`` of the cell, and the wheels' speeds; ``volts`` of motors by m/s."""
    draw = np.random.default_rng([seed, 29])
    body = parcel(
        mass_kg=float(draw.uniform(1.5, 2.5)),
        size_m=SIZE_M,
        position_m=(0.1 - 0.5 * SIZE_M[0] + off_m * draw.uniform(-1.0, 1.0), draw.uniform(-0.01, 0.01)),
        angle_rad=0.0,
        **values,
    )
    plant = solved(
        solver,
        body,
        law=law,
        effects=dict(effects or {}),
        rows=3,
        columns=3,
        pitch_m=PITCH_M,
        missing=((0, AHEAD), (2, AHEAD)),
    )
    place = plant.array.positions_m
    field = np.stack([draw.uniform(0.01, 0.02, len(place)), draw.uniform(-0.02, 0.02, len(place))], axis=1)
    ahead = place[:, 0] > 0.05
    field[ahead] = draw.uniform(-0.6, -0.5), draw.uniform(0.2, 0.3)
    return plant, field * volts
