"""Wheel speed runs over the array as waves do: second order in time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, final

import numpy as np
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.toolkit.boundary_conditions import InitialAndHeld, expand_ranges, message_speeds
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last


class WaveParameters(InitialAndHeld):
    """Speed and damping of waves, initial speeds, and cells of constant speed."""

    courant_number_squared: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.25
    """``c2 = (wave speed period / pitch)^2``: at most 1/2, or waves may grow without bound."""
    damping: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    """Share of its rate of change that a speed loses in half a period."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods."""


@final
class Wave(Firmware):
    """The wave equation by the leapfrog scheme, for both components of the speed.

    With c2 the square of the Courant number and b the damping, in every tick ::

        (1 + b) w_i[k] = (1 - b) w_i[k-1] + c2 * sum over neighbours j of (u_j[k-1] - u_i[k-1])
        u_i[k] = u_i[k-1] + w_i[k]

    and the cell drives and sends ``u_i[k]``; cells begin at rest, ``w[0] = 0``. Kept as a speed and its change, the
    scheme does not gather rounding as ``2 u[k-1] - u[k-2]`` does. Both sides of an exchange refer to the same tick.

    A side without a message (no cell there, or a dead one) is a free end, which reflects; a held cell a fixed one.
    Without damping ``E = 1/2 |w[k]|^2 + 1/2 c2 sum over links of du[k] du[k-1]``, du being the difference of a link's
    ends, stays what it was. A mode of eigenvalue lambda of the Laplacian swings at the angle t a tick, with
    ``sin(t / 2)^2 = c2 lambda / 4`` while that is at most 1: up to c2 = 1/2 on four neighbours.

    Nothing bounds it where links lose or delay messages: a word that is missing, or older than it seems, pushes out of
    step. Damping has to take out more than they put in (``docs/protocols/fields.md`` says how much was enough).

    Source: Courant, Friedrichs & Lewy, Math. Ann. 100 (1928); Strikwerda, *Finite Difference Schemes and Partial
    Differential Equations*, 2nd ed., SIAM 2004, ch. 8.
    """

    Parameters = WaveParameters
    message = np.dtype([("vx_m_s", "<f8"), ("vy_m_s", "<f8")])
    observable = "speed_m_s"

    def check(self, lattice: Lattice) -> None:
        """Every place that is named must exist, and no cell be named twice."""
        self.parameters.check("wave", lattice)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Ten times the greatest speed at the start beyond it: waves meet, but not so many; up to the limit of 1/2."""
        if self.parameters.courant_number_squared > 0.5:
            return {}
        return expand_ranges(self.parameters.range_m_s(), 10.0)

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """The limit of Courant, Friedrichs and Lewy: 1/2 on four neighbours, ``4 / lambda_max`` on this array."""
        number = self.parameters.courant_number_squared
        if number <= 0.5:
            return ()
        beyond = f"courant_number_squared {number:g} is above 1/2, the bound on four neighbours"
        grow = "waves that alternate in sign from cell to cell and from tick to tick grow"
        greatest = self.parameters.laplacian(lattice).spectrum().greatest
        if number * greatest <= 4.0:
            return (f"{beyond}; this array bears {4.0 / greatest:.6g}",)
        over = f"and above {4.0 / greatest:.6g}, what this array bears"
        factor = self._factor(greatest)
        return (f"{beyond}, {over}: {grow} by a factor of {factor:.6g} a tick, without bound",)

    def theory(self, lattice: Lattice) -> Theory:
        """Factor of the mode that lasts longest, or grows; with damping the limit is the one that heat has."""
        links = self.parameters.laplacian(lattice)
        speed, _ = self.parameters.start(lattice.rows, lattice.columns)
        ends = links.spectrum()
        factor = None if ends.least is None else max(self._factor(ends.least), self._factor(ends.greatest))
        return Theory(
            "leapfrog: greatest root of (1 + b) z^2 - (2 - c2 lambda) z + 1 - b over the Laplacian's spectrum"
            " (Courant, Friedrichs & Lewy 1928)",
            factor=factor,
            limit=links.steady_state(speed) if self.parameters.damping > 0.0 else None,
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: speeds ``(n, 2)`` m/s, their change, held cells, and no messages."""
        speed, held = self.parameters.start(cells.row, cells.column)
        sides = cells.has_neighbour.shape
        return {
            "speed_m_s": speed,
            "change_m_s": np.zeros_like(speed),
            "held": held[:, None],
            "neighbour_m_s": np.zeros((*sides, 2)),
            "counts": np.zeros(sides, dtype=np.int16),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """One step; sides are added in the order north, east, south, west."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        own, b = state["speed_m_s"], self.parameters.damping
        counts = age_ttl(inbox.received, state["counts"], self.parameters.ttl_periods)
        neighbour = hold_last(inbox.received, counts, message_speeds(inbox), state["neighbour_m_s"])
        flow = np.where(counts[:, :, None] > 0, neighbour - own[:, None, :], 0.0)
        push = flow[:, 0] + flow[:, 1] + flow[:, 2] + flow[:, 3]
        change = ((1.0 - b) * state["change_m_s"] + self.parameters.courant_number_squared * push) / (1.0 + b)
        change = np.where(state["held"], 0.0, change)
        speed = own + change

        outbox = Outbox.to_all(self.message, vx_m_s=speed[:, 0], vy_m_s=speed[:, 1])
        after = {
            **state,
            "speed_m_s": speed,
            "change_m_s": change,
            "neighbour_m_s": neighbour,
            "counts": counts,
        }
        return after, Outputs(speed, outbox)

    def _factor(self, eigenvalue: float) -> float:
        """The greatest absolute value of the two roots of a mode."""
        b = self.parameters.damping
        middle = 2.0 - self.parameters.courant_number_squared * eigenvalue
        apart = middle * middle - 4.0 * (1.0 - b * b)
        if apart < 0.0:
            return float(np.sqrt((1.0 - b) / (1.0 + b)))
        return float(abs(middle) + np.sqrt(apart)) / (2.0 * (1.0 + b))
