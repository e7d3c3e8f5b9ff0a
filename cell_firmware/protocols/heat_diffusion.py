"""Wheel speed spreads from cell to cell as heat does."""

from __future__ import annotations

from typing import Annotated, final

import numpy as np
from pydantic import Field, field_validator

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.specs import CellName, Spec, Vector


class CellSpeed(Spec):
    """A cell and its speed."""

    cell: CellName
    speed_m_s: Vector


class HeatDiffusionParameters(Spec):
    """How fast speed spreads, where from, and where it is held."""

    diffusion_number: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.2
    """``r = alpha period / pitch^2``, at most 1/4, or the explicit scheme grows without bound."""
    speed_m_s: Vector = (0.0, 0.0)
    """Speed that every cell starts with, unless ``initial`` or ``held`` names it."""
    initial: tuple[CellSpeed, ...] = ()
    """Cells that start with another speed."""
    held: tuple[CellSpeed, ...] = ()
    """Cells that keep their speed: the boundary condition."""

    @field_validator("diffusion_number")
    @classmethod
    def _stable(cls, value: float) -> float:
        if value > 0.25:
            raise ValueError(f"must be at most 0.25, not {value}: the explicit scheme is unstable above that")
        return value

    @field_validator("initial", "held")
    @classmethod
    def _each_once(cls, value: tuple[CellSpeed, ...]) -> tuple[CellSpeed, ...]:
        seen: set[tuple[int, int]] = set()
        for item in value:
            if item.cell in seen:
                raise ValueError(f"names cell [{item.cell[0]}, {item.cell[1]}] twice")
            seen.add(item.cell)
        return value


@final
class HeatDiffusion(Firmware):
    """Explicit transient heat conduction, for both components of the speed.

    In every tick a cell adds to its own speed what its neighbours' messages imply::

        u_i[k] = u_i[k-1] + r * sum over neighbours j of (u_j[k-1] - u_i[k-1])

    and drives and sends ``u_i[k]``. A message of tick k - 1 is read in tick k, so both sides of the exchange
    refer to the same tick. In tick 0 nothing has been received and ``u[0]`` is the initial speed: the wheels
    of tick k run at ``M^k u[0]``, where M is the identity plus r times the lattice's Laplacian, with the
    rows of held cells replaced by the identity's. A side without a message (no cell there, or a dead
    one) is insulated.
    """

    Parameters = HeatDiffusionParameters
    message = np.dtype([("vx_m_s", "<f8"), ("vy_m_s", "<f8")])

    def check(self, lattice: Lattice) -> None:
        """Every cell that is named must exist."""
        problems = tuple(
            Problem(
                (name, i, "cell"),
                f"the array has no cell [{item.cell[0]}, {item.cell[1]}]",
                list(item.cell),
            )
            for name, items in (("initial", self.parameters.initial), ("held", self.parameters.held))
            for i, item in enumerate(items)
            if item.cell not in lattice
        )
        if problems:
            raise ParametersError("heat_diffusion", problems)

    def init(self, cells: Cells) -> State:
        """Speeds ``(n, 2)`` m/s before tick 0, and which cells are held."""
        speed = np.empty((len(cells), 2))
        speed[:] = self.parameters.speed_m_s
        held = np.zeros((len(cells), 1), dtype=np.bool_)
        for item in self.parameters.initial:
            speed[_is(cells, item)] = item.speed_m_s
        for item in self.parameters.held:
            speed[_is(cells, item)] = item.speed_m_s
            held[_is(cells, item)] = True
        return {"speed_m_s": speed, "held": held}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """One explicit step; sides are added in the order north, east, south, west."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        own, held = state["speed_m_s"], state["held"]
        theirs = np.stack((inbox.message["vx_m_s"], inbox.message["vy_m_s"]), axis=2)
        heard = inbox.received[:, :, None]
        flow = np.where(heard, theirs - own[:, None, :], 0.0)
        gain = flow[:, 0] + flow[:, 1] + flow[:, 2] + flow[:, 3]
        speed = np.where(held, own, own + self.parameters.diffusion_number * gain)

        message = np.empty((len(own), 4), dtype=self.message)
        message["vx_m_s"], message["vy_m_s"] = speed[:, 0, None], speed[:, 1, None]
        sent = np.ones((len(own), 4), dtype=np.bool_)
        return {"speed_m_s": speed, "held": held}, Outputs(speed, Outbox(sent, message))


def _is(cells: Cells, item: CellSpeed) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return (cells.row == item.cell[0]) & (cells.column == item.cell[1])
