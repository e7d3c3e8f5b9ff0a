"""The plant's problem by SUNDIALS' CVODE, Adams' formulas with root finding, restarted at every event.

The same compiled functions as SciPy's side in ``dop853``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from dop853 import Floats, Functions, Sides
from sksundae.cvode import CVODE  # pyright: ignore[reportMissingImports]


def integrate(functions: Functions, start: Floats, end_s: float, tolerance: float) -> tuple[int, Floats]:
    """From ``start`` to ``end_s``. Returns (cells that entered or left, the last state)."""
    t, y, crossings = 0.0, start.copy(), 0
    inside = functions.cover(y)

    def rates(at: float, state: Floats, out: Floats, data: tuple[Floats, Sides]) -> None:
        out[:] = functions.motion(at, state, *data)

    def edges(at: float, state: Floats, out: Floats, data: tuple[Floats, Sides]) -> None:
        out[0] = functions.all_edges(at, state, *data)
        out[1] = functions.load(at, state, *data)

    terminates: Any = edges
    terminates.terminal, terminates.direction = [True, True], [-1, -1]
    while True:
        solver = CVODE(
            rates,
            method="Adams",
            rtol=tolerance,
            atol=tolerance,
            eventsfn=edges,
            num_events=2,
            max_num_steps=1_000_000,
            userdata=(functions.constants(inside), inside),
        )
        found: Any = solver.solve(np.array([t, end_s]), y)
        t, y = float(found.t[-1]), np.array(found.y[-1])
        if t >= end_s:
            return crossings, y
        over = functions.crossed(y, inside)
        if not len(over):
            raise RuntimeError(f"stopped at {t:g} s, where no cell crosses: {found.message}")
        inside[over] = -inside[over]
        crossings += len(over)
