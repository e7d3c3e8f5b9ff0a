"""Push-sum: all cells converge to the mean of the cells' values by gossip that loses no mass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.array_view import ArrayView
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.firmware import Cells, State
from cell_firmware.kit.gossip import MODULUS, UNIT, arrived, pushed, share_of
from cell_firmware.kit.silence import aged
from cell_firmware.program import Theory
from cell_firmware.scalar_program import ScalarProgram
from cell_firmware.specs import Finite, Positive, Spec, Vector
from cell_firmware.toolkit.graph import GraphLaplacian, components, convergence_factor
from cell_firmware.toolkit.hold import Ttl
from cell_firmware.toolkit.regions import RegionValue, assign, region_problems

MOST = MODULUS // UNIT // 4
"""Greatest sum of all values' amounts: all mass may be under way on one link."""

LEAST = UNIT >> 12
"""Least weight of a cell that is divided by: less makes no estimate."""


class PushSumParameters(Spec):
    """Values to average, and the validity of messages."""

    value: Finite = 0.0
    """Value of every cell that ``values`` does not name."""
    values: tuple[RegionValue, ...] = ()
    """Cells with other values."""
    ttl_periods: Ttl = 20
    """Silent periods after which a cell stops pushing mass to a neighbour."""
    tolerance: Positive = 1e-6
    """Spread of estimates at which cells count as agreed, as a share of the range of all values."""
    velocity_m_s: Vector = (0.0, 0.0)
    """Velocity of the wheels for an estimate of 1."""


@final
class PushSum(ScalarProgram):
    """Gossip average whose mass survives lost messages: each message has the running sum of all that was pushed.

    A cell has mass and weight, at first its value and 1. In every tick it splits both into equal shares, one for itself
    and one for each neighbour that it hears, and its estimate is mass over weight::

        s_i[k] = s_i[k-1] / (1 + d_i) + sum over neighbours j of s_j[k-1] / (1 + d_j)

    It sends the sum of all shares so far, and a neighbour takes the difference to the sum that it has seen: the first
    message after lost ones brings their mass too. Masses are whole numbers, sums wrap, and shares are rounded down, so
    that mass on cells and under way is constant to the last bit.

    The mass of a cell that dies is lost, and what was under way to it: the others converge to a mean of what they have.
    Cells that restart are outside of what it bears, since their running sums begin again.

    Source: D. Kempe, A. Dobra and J. Gehrke, "Gossip-based computation of aggregate information", FOCS 2003; C.
    Hadjicostis, N. Vaidya and A. Dominguez-Garcia, "Robust distributed average consensus via exchange of running sums",
    IEEE Trans. Automatic Control 61 (2016).
    """

    Parameters = PushSumParameters
    message = np.dtype([("mass", "<i8"), ("weight", "<i8")])
    observable = "estimate"
    is_brief = True
    compared_ticks: ClassVar[int] = 0
    constants_type = np.dtype(
        [("ttl_periods", "<i8"), ("low", "<f8"), ("high", "<f8"), ("vx_m_s", "<f8"), ("vy_m_s", "<f8")]
    )
    state_type = np.dtype(
        [
            ("given", "<i8"),  # the cell's value, units
            ("mass", "<i8"),
            ("weight", "<i8"),
            ("estimate", "<f8"),
            ("counts", "<i8", (4,)),  # for how many periods a neighbour counts as alive
            ("pushed_mass", "<i8", (4,)),  # running sums
            ("pushed_weight", "<i8", (4,)),
            ("seen_mass", "<i8", (4,)),  # of the neighbours, as last received
            ("seen_weight", "<i8", (4,)),
        ],
        align=True,
    )

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, cells named twice, and values whose sum running sums can't carry."""
        problems = region_problems(lattice, {"values": self.parameters.values})
        total = float(abs(self._values(lattice.rows, lattice.columns)).sum())
        if total > MOST or len(lattice) > MOST:
            problems += (
                Problem(("values",), f"the amounts of all values must not sum to more than {MOST}", total),
            )
        if problems:
            raise ParametersError("push_sum", problems)

    def constants(self) -> Mapping[str, float]:
        """Return the validity of messages, the range of all values, and the velocity of the wheels."""
        (low, high), (vx_m_s, vy_m_s) = self._range(), self.parameters.velocity_m_s
        return {
            "ttl_periods": self.parameters.ttl_periods,
            "low": low,
            "high": high,
            "vx_m_s": vx_m_s,
            "vy_m_s": vy_m_s,
        }

    def init(self, cells: Cells) -> State:
        """Return the initial state: value and weight 1, and nothing pushed."""
        n = len(cells)
        given = np.rint(self._values(cells.row, cells.column) * UNIT).astype(np.int64)
        each = np.zeros((n, 4), dtype=np.int64)
        return {
            "given": given,
            "mass": given,
            "weight": np.full(n, UNIT),
            "estimate": given / UNIT,
            "counts": np.where(cells.has_neighbour, self.parameters.ttl_periods, 0).astype(np.int64),
            "pushed_mass": each,
            "pushed_weight": each,
            "seen_mass": each,
            "seen_weight": each,
        }

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        """Take what has arrived, then split mass and weight."""
        neighbours = 0
        for side in range(4):
            state.counts[side] = aged(inputs.received[side] != 0, state.counts[side], constants.ttl_periods)
            if state.counts[side] > 0:
                neighbours += 1
            weight = 0
            if inputs.received[side]:
                weight = arrived(inputs.message[side].weight, state.seen_weight[side])
            if weight > 0:  # less: the message was overtaken by a newer one
                state.mass += arrived(inputs.message[side].mass, state.seen_mass[side])
                state.weight += weight
                state.seen_mass[side] = inputs.message[side].mass
                state.seen_weight[side] = inputs.message[side].weight
        if state.weight >= LEAST:  # less only where others have not been heard for long
            state.estimate = state.mass / state.weight
        mass, weight = share_of(state.mass, neighbours), share_of(state.weight, neighbours)
        for side in range(4):
            if state.counts[side] > 0:
                state.pushed_mass[side] = pushed(state.pushed_mass[side], mass)
                state.pushed_weight[side] = pushed(state.pushed_weight[side], weight)
                state.mass -= mass
                state.weight -= weight
            outputs.sent[side] = 1
            outputs.message[side].mass = state.pushed_mass[side]
            outputs.message[side].weight = state.pushed_weight[side]
        bounded = min(
            max(state.estimate, constants.low), constants.high
        )  # whatever damaged messages made of it
        outputs.speed_m_s[0] = constants.vx_m_s * bounded
        outputs.speed_m_s[1] = constants.vy_m_s * bounded

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        """Yield each cell's ledger, which makes mass on cells and under way the sum of all values, and ranges."""
        for name, first in (("mass", view["given"]), ("weight", UNIT)):
            ledger = view[name] + view[f"pushed_{name}"].sum(axis=1) - view[f"seen_{name}"].sum(axis=1)
            yield (
                f"the {name} of a cell is what it had, less what it pushed, and what it saw",
                (ledger - first) % MODULUS == 0,
            )
        low, high = self._range()
        rounding = 32.0 * (1.0 + max(-low, high)) / LEAST
        yield (
            "an estimate is in the range of all values",
            (view["estimate"] >= low - rounding) & (view["estimate"] <= high + rounding),
        )

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        """Yield that cells in reach of each other agree, within the ticks of the slowest mode.

        Where messages take D ticks, that mode decays D times as slowly at most. Mass that goes to and fro between the
        cells of either colour of the lattice decays by 0.8 parts in D³ a tick at least: such a mode has
        ``z^(D-1) (z - s) = -(1 - s)``, s being the share that stays, at least 1/5.
        """
        tolerance, (low, high) = self.parameters.tolerance, self._range()
        factor, least, part = _walk(view.cells)
        decades = np.log((2.0 + tolerance) / (tolerance * least))
        ticks = int(np.ceil(decades * (1.0 / -np.log(factor) + view.link_ticks**2 - 1)))
        rounding = 10.0 * len(view) * (1.0 + max(-low, high)) / (UNIT * (1.0 - factor))
        most, fewest = np.full(part.max() + 1, -np.inf), np.full(part.max() + 1, np.inf)
        np.maximum.at(most, part, view["estimate"])
        np.minimum.at(fewest, part, view["estimate"])
        yield (
            "all estimates agree",
            (most - fewest)[part] <= tolerance * (high - low) + rounding,
            ticks + self.parameters.ttl_periods,
        )

    def accepts(self, messages: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which messages a program may have sent: running sums below their wrap."""
        good = np.ones(messages.shape, dtype=np.bool_)
        for name in ("mass", "weight"):
            good &= (messages[name] >= 0) & (messages[name] < MODULUS)
        return good

    def theory(self, lattice: Lattice) -> Theory:
        """Factor of the lazy random walk on the array's links; the limit is the mean of each part."""
        links = GraphLaplacian(lattice, of_cell=_laziness(lattice))
        return Theory(
            "push-sum: slowest of |1 - lambda| over the spectrum of a walk with equal shares (Kempe et al. 2003)",
            factor=convergence_factor(links.spectrum(), 1.0),
            limit=links.steady_state(self._values(lattice.rows, lattice.columns)),
        )

    def _range(self) -> tuple[float, float]:
        """Return the least and the greatest of all values."""
        every = [self.parameters.value, *(region.value for region in self.parameters.values)]
        return min(every), max(every)

    def _values(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.float64]:
        values = np.full(len(row), self.parameters.value)
        assign(self.parameters.values, row, column, values)
        return values


def _laziness(lattice: Lattice) -> NDArray[np.float64]:
    """``(n,)``: s with which ``I - S L S``, S = diag(s), has the spectrum of the shares' matrix."""
    return 1.0 / np.sqrt(1.0 + (lattice.neighbours >= 0).sum(axis=1))


@lru_cache(maxsize=64)
def _walk(cells: tuple[tuple[int, int], ...]) -> tuple[float, float, NDArray[np.int64]]:
    """Return the walk's factor, the least stationary probability of a cell, and the part that each cell is in."""
    lattice = Lattice(cells)
    part = components(lattice)
    weight = 1.0 / _laziness(lattice) ** 2
    factor = convergence_factor(GraphLaplacian(lattice, of_cell=_laziness(lattice)).spectrum(), 1.0)
    least = float((weight / np.bincount(part, weight)[part]).min())
    return max(factor or 0.0, 1e-3), least, part
