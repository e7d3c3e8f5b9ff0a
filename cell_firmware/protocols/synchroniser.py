"""Synchroniser: diffusion in synchronous rounds, whatever links lose and delay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.array_view import ArrayView
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Cells, State
from cell_firmware.kit.silence import aged
from cell_firmware.kit.synchroniser import PULSES, lead, next_pulse, value_at
from cell_firmware.program import Theory
from cell_firmware.scalar_program import ScalarProgram
from cell_firmware.specs import Finite, Positive, Spec, Vector
from cell_firmware.toolkit.graph import GraphLaplacian, convergence_factor, explicit_warnings
from cell_firmware.toolkit.hold import Ttl
from cell_firmware.toolkit.regions import RegionValue, assign, region_problems


class SynchroniserParameters(Spec):
    """Values that diffuse, and the validity of messages."""

    value: Finite = 0.0
    """Value of every cell that ``values`` does not name."""
    values: tuple[RegionValue, ...] = ()
    """Cells with other values."""
    diffusion_number: Positive = 0.2
    """Share of the difference to a neighbour that flows in a round."""
    ttl_periods: Ttl = 20
    """Validity of a neighbour's message, periods; a neighbour that is silent for longer isn't waited for."""
    velocity_m_s: Vector = (0.0, 0.0)
    """Velocity of the wheels for a value of 1."""


@final
class Synchroniser(ScalarProgram):
    """Diffusion whose rounds are synchronous on links that lose and delay: every sum is kept, every bit repeats.

    A cell counts *pulses*. It goes on to the next as soon as it has heard all neighbours at its own pulse, or ahead,
    and takes a step of diffusion with their values of that pulse::

        u_i[p+1] = u_i[p] + r sum over neighbours j of (u_j[p] - u_i[p])

    Each message has the pulse, the value at it, and the value at the pulse before, so that a neighbour that is a pulse
    behind finds its own. So after p pulses a cell has the bits that it would have on perfect links after p ticks, and
    pulses of neighbours never differ by more than 1. A round takes as many ticks as its slowest message.

    Cells that restart, or begin with any pulses in one half of the circle, join the neighbour that is farthest.

    Source: B. Awerbuch, "Complexity of network synchronization", J. ACM 32 (1985), synchroniser alpha; joining as in A.
    Arora, S. Dolev and M. Gouda, "Maintaining digital clocks in step", Parallel Processing Letters 1 (1991).
    """

    Parameters = SynchroniserParameters
    message = np.dtype([("pulse", "<u4"), ("value", "<f8"), ("previous", "<f8")])
    observable = "value"
    is_brief = True
    counters: ClassVar[Mapping[str, int]] = {"pulse": PULSES}
    compared_ticks: ClassVar[int] = 0
    constants_type = np.dtype(
        [("ttl_periods", "<i8"), ("diffusion_number", "<f8"), ("vx_m_s", "<f8"), ("vy_m_s", "<f8")]
    )
    state_type = np.dtype(
        [
            ("pulse", "<i8"),
            ("value", "<f8"),  # at the pulse
            ("previous", "<f8"),  # at the pulse before
            ("waited", "<i8"),  # periods since the last pulse
            ("counts", "<i8", (4,)),  # for how many periods a neighbour is waited for
            ("heard", "u1", (4,)),  # whether a neighbour has been heard since it was last taken for dead
            ("their_pulse", "<i8", (4,)),
            ("their_value", "<f8", (4,)),
            ("their_previous", "<f8", (4,)),
        ],
        align=True,
    )

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, and cells named twice."""
        problems = region_problems(lattice, {"values": self.parameters.values})
        if problems:
            raise ParametersError("synchroniser", problems)

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of a diffusion number beyond its limit."""
        number = self.parameters.diffusion_number
        return explicit_warnings("diffusion_number", number, "values", lambda: GraphLaplacian(lattice))

    def constants(self) -> Mapping[str, float]:
        """Return the diffusion number, the validity of messages, and the velocity of the wheels."""
        given: SynchroniserParameters = self.parameters
        return {
            "ttl_periods": given.ttl_periods,
            "diffusion_number": given.diffusion_number,
            "vx_m_s": given.velocity_m_s[0],
            "vy_m_s": given.velocity_m_s[1],
        }

    def init(self, cells: Cells) -> State:
        """Return the initial state: pulse 0, and neighbours that are waited for."""
        n, value = len(cells), self._values(cells.row, cells.column)
        nothing, each = np.zeros(n, dtype=np.int64), np.zeros((n, 4))
        return {
            "pulse": nothing,
            "value": value,
            "previous": value,
            "waited": nothing,
            "counts": np.where(cells.has_neighbour, self.parameters.ttl_periods + 1, 0).astype(np.int64),
            "heard": np.zeros((n, 4), dtype=np.uint8),
            "their_pulse": np.zeros((n, 4), dtype=np.int64),
            "their_value": each,
            "their_previous": each,
        }

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        """Hear, take a step of diffusion if all neighbours are as far, and send the last two values."""
        for side in range(4):
            state.counts[side] = aged(inputs.received[side] != 0, state.counts[side], constants.ttl_periods)
            if inputs.received[side]:
                state.heard[side] = 1
                state.their_pulse[side] = inputs.message[side].pulse
                state.their_value[side] = inputs.message[side].value
                state.their_previous[side] = inputs.message[side].previous
            elif state.counts[side] == 0:
                state.heard[side] = 0
            if not state.heard[side]:  # still waited for
                state.their_pulse[side] = (state.pulse - 1) % PULSES
        pulse = next_pulse(state.pulse, state.counts, state.their_pulse)
        gained = lead(pulse, state.pulse)
        if gained == 1:
            gain = 0.0
            for side in range(4):
                if state.counts[side] > 0:
                    theirs = value_at(
                        state.pulse,
                        state.their_pulse[side],
                        state.their_value[side],
                        state.their_previous[side],
                    )
                    gain += theirs - state.value
            state.previous = state.value
            state.value = state.value + constants.diffusion_number * gain
        elif gained > 1:
            state.previous = state.value
        state.waited = 0 if gained > 0 else state.waited + 1
        state.pulse = pulse
        outputs.speed_m_s[0] = constants.vx_m_s * state.value
        outputs.speed_m_s[1] = constants.vy_m_s * state.value
        for side in range(4):
            outputs.sent[side] = 1
            outputs.message[side].pulse = state.pulse
            outputs.message[side].value = state.value
            outputs.message[side].previous = state.previous

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        """Yield that pulses of neighbours differ by 1 at most, and that every cell goes on."""
        n, ttl_periods, pulse = len(view), self.parameters.ttl_periods, view["pulse"]
        ahead = (pulse[view.neighbours] - pulse[:, None] + PULSES // 2) % PULSES - PULSES // 2
        ticks = (n + 1) * (ttl_periods + 1)
        yield (
            "pulses of neighbours differ by 1 at most",
            ~((view.neighbours >= 0) & (abs(ahead) > 1)).any(axis=1),
            ticks,
        )
        yield "every cell goes on", view["waited"] <= 2 * n + ttl_periods, ticks

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """The range of the initial values, from which a step of diffusion doesn't lead while it is a mean."""
        given: SynchroniserParameters = self.parameters
        every = [given.value, *(region.value for region in given.values)]
        low, high = min(every), max(every)
        if given.diffusion_number > 0.25:
            low, high = -10.0 * max(map(abs, every)), 10.0 * max(map(abs, every))
        return {"value": (low, high), "previous": (low, high)}

    def theory(self, lattice: Lattice) -> Theory:
        """Factor of diffusion, a round in every tick; the limit is the mean of each part."""
        links = GraphLaplacian(lattice)
        return Theory(
            "synchronous diffusion: slowest of |1 - r lambda| over the Laplacian's spectrum, a round a tick",
            factor=convergence_factor(links.spectrum(), self.parameters.diffusion_number),
            limit=links.steady_state(self._values(lattice.rows, lattice.columns)),
        )

    def _values(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.float64]:
        values = np.full(len(row), self.parameters.value)
        assign(self.parameters.values, row, column, values)
        return values
