"""Average consensus: all cells converge to the mean of the cells' values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Finite, Spec, Vector
from cell_firmware.toolkit.graph import GraphLaplacian, convergence_factor, explicit_warnings
from cell_firmware.toolkit.hold import Ttl
from cell_firmware.toolkit.regions import RegionValue, assign, region_problems
from cell_firmware.toolkit.stencil import total

_LONGER: Final = 4
"""Factor on the longest silence that has ended so far: after a longer silence a neighbour counts as dead.

With bursts of exponential length the longest of m is about ln m means long: one that is 4 times as long has a chance
of 1 in m to the fourth, so cells err a few times at first and then no more.
"""


class AverageConsensusParameters(Spec):
    """Values to average, and weights of the links."""

    source: Literal["given", "presence"] = "given"
    """Values to average: ``value`` and ``values``, or the share of a cell's sensors that see a parcel, 0 to 1."""
    value: Finite = 0.0
    """Value of every cell that ``values`` does not name."""
    values: tuple[RegionValue, ...] = ()
    """Cells with other values."""
    weight: Literal["metropolis"] | Annotated[float, Field(gt=0, allow_inf_nan=False)] = "metropolis"
    """Weight of a link: ``1 / (1 + d)``, d being the greater number of neighbours of its two cells, or a constant."""
    ttl_periods: Ttl = 20
    """Least number of silent periods after which a neighbour counts as dead, and the flow to it is taken back.

    After a neighbour has sent again after s silent periods, a cell waits 4 s periods if that is more.
    """
    velocity_m_s: Vector = (0.0, 0.0)
    """Velocity of the wheels for an estimate of 1."""


@final
class AverageConsensus(Firmware):
    """Distributed averaging that keeps its sum where messages get lost and cells die.

    A cell's estimate is what it has and what has flown to it over its links, and each link levels its two ends::

        x_i[k] = v_i[k] + sum over sides of f_ij[k]
        f_ij[k] = (f_ij[k-1] - f_ji[k-1]) / 2 + w_ij (x_j[k-1] - x_i[k-1])

    with ``f_ji`` and ``x_j`` from the neighbour's message of tick k - 1. Without a message the flow stays unchanged. On
    links that lose nothing ``f_ji = -f_ij`` to the last bit, and this is ``x[k] = (I - L_w) x[k-1]`` of Xiao & Boyd. A
    lost message makes the two ends differ, which the next exchange undoes: at rest the flows are opposite, so that the
    sum of the estimates is that of what the cells have. What cells have may change, and the mean is followed.

    A cell that dies removes its own value, and nothing else: a flow is set to 0 after ``ttl_periods`` silent periods,
    or 4 times the longest silence that any side of the cell has ended, and the others converge to their own mean. A
    long silence can't be distinguished from a death: where links are silent for longer, estimates are off by as much as
    the flows until cells have learnt how long silences last, and the mean is exact in the limit though links go on like
    that.

    Source: Xiao & Boyd, "Fast linear iterations for distributed averaging", Systems & Control Letters 53 (2004), with
    its constant and Metropolis weights; flows kept at both ends after Jesus, Baquero & Almeida, "Flow updating:
    fault-tolerant aggregation for dynamic networks", J. Parallel Distrib. Comput. 78 (2015); ttl_periods that grows
    with silences after Chandra & Toueg, "Unreliable failure detectors for reliable distributed systems", J. ACM 43
    (1996).
    """

    Parameters = AverageConsensusParameters
    message = np.dtype([("value", "<f8"), ("flow", "<f8"), ("neighbours", "u1")])
    observable = "value"

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, and cells named twice."""
        problems = region_problems(lattice, {"values": self.parameters.values})
        if problems:
            raise ParametersError("average_consensus", problems)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Ten times what cells have, for estimates on their way; a thousand times for what flows over a link."""
        parameters: AverageConsensusParameters = self.parameters
        values = [parameters.value, *(place.value for place in parameters.values)]
        most = 1.0 if parameters.source == "presence" else max(abs(value) for value in values)
        return {"value": (-10.0 * most, 10.0 * most), "flow": (-1e3 * most, 1e3 * most)}

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """A constant weight's limit; Metropolis weights have none."""
        weight = self.parameters.weight
        if weight == "metropolis":
            return ()
        return explicit_warnings("weight", weight, "estimates", lambda: GraphLaplacian(lattice))

    def theory(self, lattice: Lattice) -> Theory:
        """Factor from the weighted Laplacian's spectrum; the limit is the mean of each part that hangs together."""
        weight = self.parameters.weight
        if weight == "metropolis":
            degree = (lattice.neighbours >= 0).sum(axis=1)
            links = GraphLaplacian(
                lattice, weight=1.0 / (1.0 + np.maximum(degree[:, None], degree[lattice.neighbours]))
            )
        else:
            links = GraphLaplacian(lattice, weight=np.full((len(lattice), 4), weight))
        given = self._given(lattice.rows, lattice.columns)
        return Theory(
            "averaging: slowest of |1 - lambda| over the weighted Laplacian's spectrum (Xiao & Boyd 2004)",
            factor=convergence_factor(links.spectrum(), 1.0),
            limit=None if self.parameters.source == "presence" else links.steady_state(given),
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: values and estimates, ``(n,)``, and flows over each side, ``(n, 4)``.

        Also the silence of each side, ``(n, 4)`` periods, -1 before its first message; and the longest silence that any
        side of the cell has ended, ``(n,)`` periods.
        """
        given = self._given(cells.row, cells.column)
        has_neighbour = cells.has_neighbour
        neighbours = sum(has_neighbour[:, side].astype(np.uint8) for side in range(4))
        return {
            "given": given,
            "value": given,
            "flow": np.zeros(has_neighbour.shape),
            "silent": np.full(has_neighbour.shape, -1),
            "longest": np.zeros(len(cells), dtype=np.int64),
            "neighbours": np.asarray(neighbours),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Level every link on which a message arrived, and sum the flows."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        silent, longest = _silences(inbox.received, state["silent"], state["longest"])
        there = silent < np.maximum(self.parameters.ttl_periods, _LONGER * longest)[:, None]
        theirs, own = inbox.message, state["value"][:, None]
        level = self._weight(state["neighbours"][:, None], theirs["neighbours"]) * (theirs["value"] - own)
        levelled = (state["flow"] - theirs["flow"]) / 2.0 + level
        flow = np.where(inbox.received, levelled, np.where(there, state["flow"], 0.0))
        given = _seen(inputs) if self.parameters.source == "presence" else state["given"]
        value = given + total(flow)

        outbox = Outbox.to_all(self.message, value=value, neighbours=state["neighbours"], flow=value)
        outbox.message["flow"] = flow
        speed = value[:, None] * np.array(self.parameters.velocity_m_s)
        after = {**state, "given": given, "value": value, "flow": flow, "silent": silent, "longest": longest}
        return after, Outputs(speed, outbox)

    def _given(self, row: np.ndarray, column: np.ndarray) -> Floats:
        given = np.full(len(row), self.parameters.value)
        assign(self.parameters.values, row, column, given)
        return given

    def _weight(self, own: np.ndarray, theirs: np.ndarray) -> Floats | float:
        weight = self.parameters.weight
        return 1.0 / (1.0 + np.maximum(own, theirs)) if weight == "metropolis" else weight


def _silences(
    received: Bools, silent: NDArray[np.int64], longest: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the silence of each side, and the longest silence that a side has ended, periods.

    Args:
        received: ``(n, 4)``, whether a message arrived.
        silent: ``(n, 4)``, previous silences; -1 for a side without any message yet.
        longest: ``(n,)``, previous longest silence.
    """
    broken = np.where(received, silent, 0).max(axis=1)
    return np.where(received, 0, silent + (silent >= 0)), np.maximum(longest, broken)


def _seen(inputs: Inputs) -> Floats:
    """Return the share of a cell's sensors that see a parcel, ``(n,)``."""
    sensors = inputs.presence.shape[1]
    seen = np.zeros(len(inputs.presence))
    for sensor in range(sensors):
        seen = seen + inputs.presence[:, sensor]
    return seen / sensors
