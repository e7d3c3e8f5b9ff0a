"""Potential flow of an incompressible fluid, from sources to sinks and around obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Finite, Spec
from cell_firmware.toolkit.graph import (
    GraphLaplacian,
    components,
    convergence_factor,
    explicit_warnings,
    second_order,
)
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last
from cell_firmware.toolkit.regions import Region, assign, region_problems
from cell_firmware.toolkit.stencil import across, gradient, total


class Source(Region):
    """Cells, and the flow out of each of them."""

    flow_m2_s: Finite
    """Flow out of each cell per unit of height; below 0 a sink."""

    @property
    def amount(self) -> float:
        """Flow out of each cell."""
        return self.flow_m2_s


class StreamParameters(Spec):
    """Sources and sinks of the fluid, and relaxation of the potential."""

    sources: Annotated[tuple[Source, ...], Field(min_length=1)]
    """Sources and sinks; their flows should add up to 0."""
    diffusion_number: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.2
    """Factor with which a cell corrects its balance of flows: at most 1/4, or potentials may alternate and grow."""
    relaxation: Annotated[float, Field(ge=1, lt=2, allow_inf_nan=False)] = 1.0
    """Relaxation factor: 1 for explicit steps; more for the second-order method, faster if it suits the array."""
    ttl_periods: Ttl = 50
    """Validity of a neighbour's message, periods; then the neighbour counts as dead, and its side as a wall."""


@final
class Stream(Firmware):
    """Potential flow: the flow through the face between two cells is the difference of their potentials.

    A cell adds to its potential what its balance lacks, r being the diffusion number, s its source, w the relaxation::

        q_i[k] = q_i[k-2] + w (q_i[k-1] + r (s_i + sum over neighbours j of (q_j - q_i)[k-1]) - q_i[k-2])

    At rest what flows out of every cell is its source: net flow 0 through the faces of all others, to rounding, which
    is what incompressible means on cells. A side without a neighbour, or with one that died and was silent for
    ``ttl_periods`` periods, is a wall: nothing flows through it, and the stream goes round. Wheels run at the mean
    velocity of opposite faces, flow over pitch. Potentials are known up to a constant, which has no effect.

    Where sources are not even every cell of their part takes an equal share of what is too much, its potential rises
    for ever, and the flow still settles. Lost and late messages cost time, and shift the constant; with w > 1 late ones
    may make potentials grow without bound.

    Source: Batchelor, *An Introduction to Fluid Dynamics*, Cambridge 1967, ch. 6 (irrotational flow); Patankar,
    *Numerical Heat Transfer and Fluid Flow*, 1980, ch. 3 (finite volumes); Golub & Varga, Numer. Math. 3 (1961).
    """

    Parameters = StreamParameters
    message = np.dtype([("potential_m2_s", "<f8")])
    observable = "potential_m2_s"

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, and cells named twice."""
        problems = region_problems(lattice, {"sources": self.parameters.sources})
        if problems:
            raise ParametersError("stream", problems)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the range of potentials: as much as the strongest source drives through a million cells in a row."""
        most = 1e6 * max(abs(source.flow_m2_s) for source in self.parameters.sources)
        return {"potential_m2_s": (-most, most)}

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of an unstable diffusion number, and of unbalanced sources."""
        number = self.parameters.diffusion_number
        found = explicit_warnings("diffusion_number", number, "potentials", lambda: GraphLaplacian(lattice))
        for cells, surplus in self._uneven(lattice):
            part = f"sources of the {cells.sum()} cells about {list(lattice.cells[int(np.argmax(cells))])}"
            share = f"each cell gains {surplus / cells.sum():.6g} m2/s, so the flow is not incompressible"
            found += (f"{part} are {surplus:.6g} m2/s out of balance: {share}",)
        return found

    def theory(self, lattice: Lattice) -> Theory:
        """Factor from the Laplacian's spectrum; the limit balances every cell, with mean 0, if sources are even."""
        p, links = self.parameters, GraphLaplacian(lattice)
        radius = convergence_factor(links.spectrum(), p.diffusion_number)
        even = not any(True for _ in self._uneven(lattice))
        source = self._source(lattice.rows, lattice.columns)
        return Theory(
            "potential flow: slowest of |1 - r lambda| over the Laplacian's spectrum, second order if relaxation > 1"
            " (Golub & Varga 1961)",
            factor=None if radius is None else second_order(radius, p.relaxation),
            limit=links.steady_state(np.zeros(len(lattice)), source) if even else None,
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: potentials ``(n,)`` m2/s of this tick and the last, sources, messages, pitch."""
        sides = cells.has_neighbour.shape
        return {
            "potential_m2_s": np.zeros(len(cells)),
            "before_m2_s": np.zeros(len(cells)),
            "source_m2_s": self._source(cells.row, cells.column),
            "neighbour_m2_s": np.zeros(sides),
            "counts": np.zeros(sides, dtype=np.int16),
            "pitch_m": np.full(len(cells), cells.pitch_m),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Relax once; drive by the differences between the potentials of the previous tick."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        own, before = state["potential_m2_s"], state["before_m2_s"]
        counts = age_ttl(inbox.received, state["counts"], self.parameters.ttl_periods)
        neighbour = hold_last(
            inbox.received, counts, inbox.message["potential_m2_s"], state["neighbour_m2_s"]
        )
        faces = across(counts > 0, neighbour, own)
        levelled = own + self.parameters.diffusion_number * (state["source_m2_s"] + total(faces))
        potential = before + self.parameters.relaxation * (levelled - before)

        after = {
            **state,
            "potential_m2_s": potential,
            "before_m2_s": own,
            "neighbour_m2_s": neighbour,
            "counts": counts,
        }
        speed = -gradient(faces, state["pitch_m"])
        return after, Outputs(speed, Outbox.to_all(self.message, potential_m2_s=potential))

    def _source(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> Floats:
        source = np.zeros(len(row))
        assign(self.parameters.sources, row, column, source)
        return source

    def _uneven(self, lattice: Lattice) -> Iterator[tuple[Bools, float]]:
        """Yield parts of the array with unbalanced sources: cells, and surplus of the part."""
        source, part = self._source(lattice.rows, lattice.columns), components(lattice)
        for one in range(int(part.max()) + 1):
            surplus = float(source[part == one].sum())
            if abs(surplus) > 1e-9 * float(abs(source).sum()):
                yield part == one, surplus
