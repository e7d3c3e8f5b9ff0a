"""Wheel speed spreads from cell to cell as heat does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, final

import numpy as np
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.firmware import Cells, State
from cell_firmware.program import Theory
from cell_firmware.scalar import ScalarFirmware
from cell_firmware.toolkit.boundary_conditions import InitialAndHeld, expand_ranges
from cell_firmware.toolkit.graph import convergence_factor, explicit_warnings
from cell_firmware.toolkit.hold import Ttl


class HeatDiffusionParameters(InitialAndHeld):
    """Rate of diffusion, initial speeds, and cells of constant speed."""

    diffusion_number: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.2
    """``r = alpha period / pitch^2``: at most 1/4, or speeds may alternate and grow."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods: more than 1 where messages get lost."""


@final
class HeatDiffusion(ScalarFirmware):
    """Explicit transient heat conduction, for both components of the speed.

    In every tick a cell adds to its own speed what its neighbours' messages imply::

        u_i[k] = u_i[k-1] + r * sum over neighbours j of (u_j[k-1] - u_i[k-1])

    and drives and sends ``u_i[k]``. A message of tick k - 1 is read in tick k, so both sides of the exchange
    refer to the same tick. In tick 0 nothing has been received and ``u[0]`` is the initial speed: the wheels
    of tick k run at ``M^k u[0]``, where M is the identity less r times the lattice's Laplacian, with the
    rows of held cells replaced by the identity's.

    Where no message comes the last one counts, for ``ttl_periods`` periods in all. A side without one (no cell there,
    or a dead one) is insulated.

    Up to r = 1/4 every speed is a mean of speeds there were, with weights of at least 0, whatever links lose or delay:
    it stays in the range in which all began. On links that do neither, the slowest error shrinks by
    ``max |1 - r lambda|`` a tick, over the eigenvalues of the Laplacian of the cells that are not held.

    Source: Crank, *The Mathematics of Diffusion*, 2nd ed., Oxford 1975, ch. 8 (explicit scheme and its limit).
    """

    Parameters = HeatDiffusionParameters
    message = np.dtype([("vx_m_s", "<f8"), ("vy_m_s", "<f8")])
    observable = "speed_m_s"
    kernels = "cell_firmware.kernels.programs.heat_diffusion"

    def check(self, lattice: Lattice) -> None:
        """Every place that is named must exist, and no cell be named twice."""
        self.parameters.check("heat_diffusion", lattice)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """The range in which all began, which no mean leaves; up to r = 1/4."""
        if self.parameters.diffusion_number > 0.25:
            return {}
        return expand_ranges(self.parameters.range_m_s(), 1e-6)

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """The scheme's limit: 1/4 on four neighbours, ``2 / lambda_max`` on this array."""
        number, links = self.parameters.diffusion_number, self.parameters.laplacian
        return explicit_warnings("diffusion_number", number, "speeds", lambda: links(lattice))

    def theory(self, lattice: Lattice) -> Theory:
        """Factor from the spectrum; the limit is harmonic between held cells, and flat where there are none."""
        links = self.parameters.laplacian(lattice)
        speed, _ = self.parameters.start(lattice.rows, lattice.columns)
        number = self.parameters.diffusion_number
        return Theory(
            f"explicit conduction: slowest of |1 - {number:g} lambda| over the Laplacian's spectrum (Crank 1975)",
            factor=convergence_factor(links.spectrum(), number),
            limit=links.steady_state(speed),
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: speeds ``(n, 2)`` m/s, held cells, and no messages."""
        speed, held = self.parameters.start(cells.row, cells.column)
        sides = cells.has_neighbour.shape
        return {
            "speed_m_s": speed,
            "held": held[:, None],
            "neighbour_m_s": np.zeros((*sides, 2)),
            "counts": np.zeros(sides, dtype=np.int16),
        }

    def constants(self) -> Mapping[str, float]:
        """Rate of diffusion, and validity of messages."""
        return {
            "diffusion_number": self.parameters.diffusion_number,
            "ttl_periods": self.parameters.ttl_periods,
        }
