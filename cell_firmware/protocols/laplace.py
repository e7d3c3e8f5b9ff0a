"""Laplace potential: cells relax between held cells, and wheels drive along the gradient."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Finite, NotNegative, Spec
from cell_firmware.toolkit.graph import GraphLaplacian, hop_distance, second_order
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last
from cell_firmware.toolkit.regions import RegionValue, assign, region_problems
from cell_firmware.toolkit.stencil import across, gradient, total


class LaplaceParameters(Spec):
    """Held potentials, relaxation, and speed of the wheels."""

    held: Annotated[tuple[RegionValue, ...], Field(min_length=1)]
    """Cells that keep their potential: sources, sinks, obstacles that repel."""
    relaxation: Annotated[float, Field(ge=1, lt=2, allow_inf_nan=False)] = 1.0
    """Relaxation factor: 1 for Jacobi's method; more for the second-order method, much faster if it suits the array."""
    ttl_periods: Ttl = 50
    """Validity of a neighbour's message, periods; then the neighbour counts as dead, and its side as insulated."""
    speed_m_s: NotNegative | None = None
    """Constant speed of the wheels down the potential."""
    gain_m2_s: Finite | None = None
    """Wheel speed per slope of the potential, instead of ``speed_m_s``; below 0 parcels climb."""

    @model_validator(mode="after")
    def _at_most_one(self) -> Self:
        if self.speed_m_s is not None and self.gain_m2_s is not None:
            raise ValueError("give speed_m_s or gain_m2_s, not both")
        return self


@final
class Laplace(Firmware):
    """Relaxation to a harmonic potential: the electric field between electrodes, on cells.

    A cell takes the mean of its neighbours' last potentials, with the relaxation w as ::

        p_i[k] = p_i[k-2] + w (mean over neighbours j of p_j[k-1] - p_i[k-2])

    and held cells keep theirs. At w = 1 that is Jacobi's method, whose error shrinks by rho a tick, the spectral
    radius of the mean over neighbours that are not held: cos(pi / (N + 1)) for N x N cells within a held border. With
    w > 1 it is the stationary second-order method, at best ``w = 2 / (1 + sqrt(1 - rho^2))`` by ``sqrt(w - 1)`` a tick:
    as many rounds as the array is wide instead of that squared. The successive over-relaxation of textbooks needs
    values of this tick from half the cells, which no message can bring.

    No potential leaves the range of what is held and the 0 at which cells start. Lost and late messages cost time
    alone: the limit is the same (at w = 1, for any delays below the ttl_periods: Chazan & Miranker 1969). With w > 1
    that holds for lost messages; with late messages potentials may oscillate within their range.

    Parcels can rest at held cells only: a harmonic potential has no other minimum. Places without a cell, and dead
    cells that were silent for ``ttl_periods`` periods, are insulators: the field goes around them.

    Source: Golub & Varga, "Chebyshev semi-iterative methods, successive overrelaxation iterative methods, and second
    order Richardson iterative methods", Numer. Math. 3 (1961); Connolly, Burns & Weiss, "Path planning using
    Laplace's equation", ICRA 1990.
    """

    Parameters = LaplaceParameters
    message = np.dtype([("potential", "<f8")])
    observable = "potential"

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, and cells named twice."""
        problems = region_problems(lattice, {"held": self.parameters.held})
        if problems:
            raise ParametersError("laplace", problems)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the range of held potentials, which no cell exceeds."""
        return {"potential": self._range()}

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of cells without a way to a held cell, and of a flat potential."""
        found: list[str] = []
        potential, held = self._start(lattice.rows, lattice.columns)
        if np.ptp(potential[held]) == 0.0:
            found.append("all held cells have the same potential: it becomes flat, and wheels stand")
        loose = int((hop_distance(lattice, np.flatnonzero(held)) < 0).sum())
        if loose:
            found.append(
                f"{loose} cells have no route to a held cell: their potential stays 0, and their wheels stand"
            )
        return tuple(found)

    def theory(self, lattice: Lattice) -> Theory:
        """Predict the factor from the spectral radius of the mean over neighbours; the limit is harmonic."""
        potential, held = self._start(lattice.rows, lattice.columns)
        links = GraphLaplacian(lattice, held)
        degree = np.maximum((lattice.neighbours >= 0).sum(axis=1), 1)
        ends = GraphLaplacian(lattice, held | links.unanchored, of_cell=1.0 / np.sqrt(degree)).spectrum()
        radius = None if ends.least is None else max(1.0 - ends.least, ends.greatest - 1.0)
        return Theory(
            "relaxation: spectral radius of the mean over neighbours, second order if relaxation > 1"
            " (Golub & Varga 1961)",
            factor=None if radius is None else second_order(radius, self.parameters.relaxation),
            limit=links.steady_state(potential),
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: potentials ``(n,)`` of this tick and the last, held cells, messages, and pitch."""
        potential, held = self._start(cells.row, cells.column)
        sides = cells.has_neighbour.shape
        return {
            "potential": potential,
            "before": potential,
            "held": held,
            "neighbour": np.zeros(sides),
            "counts": np.zeros(sides, dtype=np.int16),
            "pitch_m": np.full(len(cells), cells.pitch_m),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Relax once; drive by the slope between the potentials of the previous tick."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        own, before = state["potential"], state["before"]
        counts = age_ttl(inbox.received, state["counts"], self.parameters.ttl_periods)
        neighbour = hold_last(inbox.received, counts, inbox.message["potential"], state["neighbour"])
        valid = counts > 0
        number = total(valid.astype(np.float64))
        mean = total(np.where(valid, neighbour, 0.0)) / np.where(number > 0.0, number, 1.0)
        relaxed = before + self.parameters.relaxation * (mean - before)
        lowest, highest = self._range()
        bounded = np.minimum(np.maximum(relaxed, lowest), highest)
        potential = np.where(state["held"] | (number == 0.0), own, bounded)

        speed = self._speed(across(valid, neighbour, own), state["held"], state["pitch_m"])
        after = {**state, "potential": potential, "before": own, "neighbour": neighbour, "counts": counts}
        return after, Outputs(speed, Outbox.to_all(self.message, potential=potential))

    def _start(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[Floats, Bools]:
        potential = np.zeros(len(row))
        return potential, assign(self.parameters.held, row, column, potential)

    def _range(self) -> tuple[float, float]:
        """The least and the greatest potential that is held; 0, at which cells start, among them."""
        values = [place.value for place in self.parameters.held]
        return min(*values, 0.0), max(*values, 0.0)

    def _speed(self, faces: Floats, held: Bools, pitch_m: Floats) -> Floats:
        """Down the slope. A held cell looks to those below it alone: a source feeds them, and a sink stands.

        Less than a billionth of the potentials' range a cell is rounding: at a set speed wheels stand then.
        """
        speed, gain = self.parameters.speed_m_s, self.parameters.gain_m2_s
        further = np.maximum(faces, 0.0) if gain is not None and gain < 0.0 else np.minimum(faces, 0.0)
        slope = gradient(np.where(held[:, None], further, faces), pitch_m)
        if speed is None:
            return slope * (0.0 if gain is None else -gain)
        lowest, highest = self._range()
        steep = np.sqrt(slope[:, 0] * slope[:, 0] + slope[:, 1] * slope[:, 1])
        runs = steep > 1e-9 * (highest - lowest) / pitch_m
        return np.where(runs[:, None], slope * (-speed / np.where(runs, steep, 1.0))[:, None], 0.0)
