"""Protocols of the kit on many arrays, from arbitrary registers, through deaths and losses, beside theory.

Every array has random numbers of its own seed: its holes, registers, values, deaths. One lab steps all arrays, which
have no links between them. What is right is computed by NetworkX and NumPy on the arrays' graphs, without a function of
the protocols.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from bus.random_streams import rng
from mdms import Lab
from mdms.kit import MODULUS, UNIT

ROWS, COLUMNS, MOST_HOLES, DEATHS = 6, 8, 6, 5
LOSSY_TICKS, LOSS = 20, 0.3
LIMIT = 49
"""Distance bound of the tree: more than there are cells on any way of such an array."""

CellName = tuple[int, int]
Ranges = dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Settled:
    """Ticks from the last disturbance until everything is right for good, a row an array, and theory's bounds.

    Attributes:
        what: Which.
        ticks: As measured.
        bound: As predicted.
    """

    what: str
    ticks: NDArray[np.int64]
    bound: NDArray[np.int64]


class Arrays:
    """Arrays with holes, one a seed, above each other with a row between them.

    Args:
        seeds: Of the arrays.
        whole: Whether an array is what hangs together of it, the largest part.
    """

    def __init__(self, seeds: Sequence[int], *, whole: bool = False) -> None:
        self.seeds = seeds
        self.each = [self._cells(seed, i * (ROWS + 1), whole=whole) for i, seed in enumerate(seeds)]
        self.cells = [cell for cells in self.each for cell in cells]  # in the lattice's order
        self.index = {cell: i for i, cell in enumerate(self.cells)}
        self.starts = np.cumsum([0, *map(len, self.each)])[:-1]
        self.array = np.repeat(np.arange(len(seeds)), [len(cells) for cells in self.each])

    @staticmethod
    def _cells(seed: int, above: int, *, whole: bool) -> list[CellName]:
        draw = rng(seed, "trial.holes")
        every = [(row + above, column) for row in range(ROWS) for column in range(COLUMNS)]
        holes = set(draw.choice(len(every), draw.integers(0, MOST_HOLES + 1), replace=False).tolist())
        left = [cell for i, cell in enumerate(every) if i not in holes]
        return sorted(max(nx.connected_components(graph_of(left)), key=len)) if whole else left

    def drawn(self, stream: str, one: Callable[[np.random.Generator, int], Any]) -> Any:
        """Draw something for each cell, from each array's seed: ``one`` takes the generator and the number of cells."""
        parts = zip(self.seeds, self.each, strict=True)
        return np.concatenate([one(rng(seed, stream), len(cells)) for seed, cells in parts])

    def all_of(self, right: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return whether all cells of each array are right, ``(ticks, n)`` to ``(ticks, arrays)``."""
        return np.logical_and.reduceat(right, self.starts, axis=-1)


def graph_of(cells: Iterable[CellName]) -> Any:
    """The cells and their links."""
    graph = nx.Graph()
    graph.add_nodes_from(cells)
    for row, column in list(graph):
        for there in ((row + 1, column), (row, column + 1)):
            if there in graph:
                graph.add_edge((row, column), there)
    return graph


def corrupt(lab: Lab, arrays: Arrays, ranges: Ranges) -> None:
    """Give registers of all cells random values; a range is from, and up to but not."""
    for name, (low, high) in ranges.items():
        shape = lab.registers[name].shape[1:]
        lab.registers[name] = arrays.drawn(
            f"trial.{name}",
            lambda draw, n, low=low, high=high, shape=shape: draw.integers(low, high, (n, *shape)),
        )


def disturb(
    lab: Lab, arrays: Arrays, also: Iterable[CellName] = (), *, repaired: bool = False
) -> set[CellName]:
    """Have cells of each array die while messages get lost for some ticks; returns which are dead after those."""
    dead = set(also)
    for seed, cells in zip(arrays.seeds, arrays.each, strict=True):
        dead |= {
            cells[i] for i in rng(seed, "trial.deaths").choice(len(cells), DEATHS, replace=False).tolist()
        }
    lab.inject("link_loss", LOSSY_TICKS, probability=LOSS, share=1.0)
    lab.step(3)
    lab.inject("crash", LOSSY_TICKS - 3 if repaired else None, cells=[list(cell) for cell in sorted(dead)])
    lab.step(LOSSY_TICKS - 3)
    return set() if repaired else dead


def last_wrong(right: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Ticks until all stays right, of ``(ticks, ...)``."""
    ticks = np.arange(1, len(right) + 1).reshape(-1, *(1,) * (right.ndim - 1))
    return np.where(right, 0, ticks).max(axis=0)


# --- tree and convergecast --------------------------------------------------------------------------


def tree_trials(seeds: Sequence[int]) -> list[Settled]:
    """Spanning tree from arbitrary registers; then deaths, the root's among them in every other array."""
    arrays = Arrays(seeds)
    lab = Lab("spanning_tree", arrays.cells, parameters={"limit": LIMIT}, check=None)
    keys, hops, side, totals = (0, 1 << 32), (0, LIMIT), (0, 5), (0, 1 << 31)
    ranges: Ranges = {"root": keys, "their_root": keys, "distance": hops, "their_distance": hops}
    ranges |= {"parent": side, "their_parent": side, "counts": (0, 99)}
    for name in ("cells", "covered", "all_cells", "all_covered"):
        ranges |= {name: totals, f"their_{name}": totals}
    corrupt(lab, arrays, ranges)
    covered = arrays.drawn("trial.parcels", lambda draw, n: draw.random(n) < 0.3)
    lab.presence = covered
    begun = _tree_settles(lab, arrays, set(), covered, "")
    roots = [min(cells) for seed, cells in zip(seeds, arrays.each, strict=True) if seed % 2]
    return begun + _tree_settles(lab, arrays, disturb(lab, arrays, roots), covered, ", after deaths")


def _tree_settles(
    lab: Lab, arrays: Arrays, dead: set[CellName], covered: NDArray[np.bool_], when: str
) -> list[Settled]:
    distance, count, sensed = (np.full(len(arrays.cells), -1) for _ in range(3))
    depth = np.zeros(len(arrays.seeds), dtype=np.int64)
    for part in nx.connected_components(graph_of(set(arrays.cells) - dead)):
        away = nx.single_source_shortest_path_length(graph_of(part), min(part))  # the least place leads
        rows = [arrays.index[cell] for cell in part]
        distance[rows] = [away[cell] for cell in part]
        count[rows], sensed[rows] = len(part), covered[rows].sum()
        of = arrays.array[rows[0]]
        depth[of] = max(depth[of], *away.values())
    bounds = LIMIT + depth + 1, LIMIT + depth + 1 + 2 * (depth + 1)
    trees: list[Any] = []
    counts: list[Any] = []
    for _ in range(max(bounds[1]) + 10):
        view = lab.step().registers
        trees.append((view["distance"] == distance) | (distance < 0))
        counts.append(((view["all_cells"] == count) & (view["all_covered"] == sensed)) | (distance < 0))
    return [
        Settled(f"{what}{when}", last_wrong(arrays.all_of(np.array(right))), bound)
        for what, right, bound in zip(("tree", "counts"), (trees, counts), bounds, strict=True)
    ]


# --- push-sum ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gossiped:
    """Outcome of push-sum, a row an array.

    Attributes:
        share_of_bound: Greatest error of a cell on perfect links in any tick, over the spectral bound for the tick.
        mass_lost: Units of mass or weight that were missing in any tick, on perfect links or on lossy ones.
        perfect_ticks: Ticks until all errors stay below ``ENOUGH`` of the range of values, on perfect links.
        lossy_ticks: The same on lossy links.
        bound_ticks: The same by the spectral bound, for perfect links.
    """

    share_of_bound: NDArray[np.float64]
    mass_lost: NDArray[np.int64]
    perfect_ticks: NDArray[np.int64]
    lossy_ticks: NDArray[np.int64]
    bound_ticks: NDArray[np.int64]


GOSSIP_TICKS = 1000
ENOUGH = 1e-6
ROUNDING = 1e-7
"""Errors by rounding masses to whole numbers; values are between -8 and 8."""


def gossip_trials(seeds: Sequence[int]) -> Gossiped:
    """Push-sum of random values on links that lose nothing, then on lossy ones."""
    arrays = Arrays(seeds, whole=True)
    value = arrays.drawn("trial.values", lambda draw, n: np.rint(draw.uniform(-8.0, 8.0, n) * UNIT)).astype(
        np.int64
    )
    loss = {"kind": "link_loss", "probability": LOSS, "share": 1.0}
    runs = [_gossip(arrays, value, faults) for faults in ((), (loss,))]
    size = np.diff([*arrays.starts, len(arrays.cells)])
    mean = np.add.reduceat(value, arrays.starts) / size / UNIT
    span = (np.maximum.reduceat(value, arrays.starts) - np.minimum.reduceat(value, arrays.starts)) / UNIT
    bounds = np.concatenate(
        [
            spectral_bound(graph_of(cells), cells, value[start : start + len(cells)] / UNIT)
            for start, cells in zip(arrays.starts, arrays.each, strict=True)
        ],
        axis=1,
    )
    errors = [abs(estimates - mean[arrays.array]) for estimates, _ in runs]
    enough = ENOUGH * span[arrays.array]
    share = ((errors[0] - ROUNDING) / bounds).max(axis=0)  # no bound yet is an infinite one
    return Gossiped(
        np.maximum.reduceat(share, arrays.starts),
        np.maximum(runs[0][1], runs[1][1]),
        *(last_wrong(arrays.all_of(error < enough)) for error in (*errors, bounds)),
    )


def _gossip(
    arrays: Arrays, value: NDArray[np.int64], faults: Any
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Estimates in every tick, ``(ticks, n)``, and the greatest mass that an array missed."""
    lab = Lab("push_sum", arrays.cells, faults=faults, check=None)
    lab.registers["given"] = lab.registers["mass"] = value
    estimates: list[NDArray[np.float64]] = []
    lost = np.zeros(len(arrays.seeds), dtype=np.int64)
    for tick in range(GOSSIP_TICKS):
        view = lab.step().view()
        estimates.append(view["estimate"].copy())
        if tick % 10 and tick > 20:
            continue
        for name, first in (("mass", value), ("weight", np.full(len(value), UNIT))):
            there = view[name] + _under_way(view, name)
            lost = np.maximum(lost, abs(np.add.reduceat(there - first, arrays.starts)))
    return np.array(estimates), lost


def _under_way(view: Any, name: str) -> NDArray[np.int64]:
    """Mass that each cell has pushed and its neighbours have not yet seen, ``(n,)`` units."""
    pushed, seen, total = view[f"pushed_{name}"], view[f"seen_{name}"], np.zeros(len(view), dtype=np.int64)
    for side in range(4):
        there = view.neighbours[:, side]
        flight = (pushed[:, side] - seen[there, (side + 2) % 4]) % MODULUS
        flight = np.where(flight > MODULUS // 2, flight - MODULUS, flight)
        total += np.where(there >= 0, flight, 0)
    return total


def spectral_bound(graph: Any, cells: list[CellName], value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bound on each cell's error in each tick, ``(ticks, n)``; infinite where there is none yet.

    With P the matrix of equal shares, pi its stationary law and rho the modulus of its second eigenvalue,
    ``|y_i[k]| <= sqrt(pi_i) rho^k ||y[0]||`` in the norm of ``y / sqrt(pi)`` for every y of sum 0.
    """
    adjacency = nx.to_numpy_array(graph, nodelist=cells) + np.eye(len(cells))
    degree = adjacency.sum(axis=0)
    pi = degree / degree.sum()
    rho = np.sort(abs(np.linalg.eigvals(adjacency / degree)))[-2]
    n, mean = len(cells), value.mean()

    def norm(y: NDArray[np.float64]) -> float:
        return float(np.sqrt((y * y / pi).sum()))

    decay = rho ** np.arange(GOSSIP_TICKS)[:, None]
    above = np.sqrt(pi) * decay * norm(value - mean)
    below = n * pi - np.sqrt(pi) * decay * norm(1.0 - n * pi)
    return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.inf)


# --- slots ------------------------------------------------------------------------------------------


def slots_trials(seeds: Sequence[int]) -> list[Settled]:
    """Slots from arbitrary registers; then cells that die and come back, while messages get lost."""
    arrays = Arrays(seeds)
    within_two = [nx.power(graph_of(cells), 2) for cells in arrays.each]
    pairs = np.array([[arrays.index[a], arrays.index[b]] for graph in within_two for a, b in graph.edges])
    pointed = [nx.DiGraph((min(pair), max(pair)) for pair in graph.edges) for graph in within_two]
    bounds = np.array([2 * (nx.dag_longest_path_length(graph) + 1) + 1 for graph in pointed])
    found: list[Settled] = []
    for choice in ("least", "random"):
        lab = Lab("distance2_slots", arrays.cells, parameters={"choice": choice}, seed=seeds[0], check=None)
        every = (-9, 300)
        corrupt(lab, arrays, {"slot": every, "near": every, "beyond": every, "counts": (0, 99)})
        found.append(_slots_settle(lab, arrays, pairs, bounds, f"slots, {choice}"))
        disturb(lab, arrays, repaired=True)
        found.append(_slots_settle(lab, arrays, pairs, bounds, f"slots, {choice}, after repairs"))
    return found


def _slots_settle(
    lab: Lab, arrays: Arrays, pairs: NDArray[np.int64], bounds: NDArray[np.int64], what: str
) -> Settled:
    slots = lab.record("slot", max(bounds) + 10)
    right = (slots == slots[-1]) & (slots >= 0) & (slots < 16)  # final, and in the frame
    ticks, clashes = np.nonzero(slots[:, pairs[:, 0]] == slots[:, pairs[:, 1]])
    right[ticks, pairs[clashes, 0]] = False
    return Settled(what, last_wrong(arrays.all_of(right)), bounds)


# --- synchroniser -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Synchronised:
    """Outcome of the synchroniser, a row an array.

    Attributes:
        wrong: Cells and ticks whose value differs, in any bit, from that of the pulse on perfect links.
        apart: Greatest difference between the pulses of neighbours.
        pulses: Least number of pulses of a cell in the end.
    """

    wrong: NDArray[np.int64]
    apart: NDArray[np.int64]
    pulses: NDArray[np.int64]


SYNCHRONISED_TICKS = 150


def synchroniser_trials(seeds: Sequence[int]) -> Synchronised:
    """Diffusion of random values in synchronous rounds, on links that lose, delay and reorder messages."""
    arrays = Arrays(seeds)
    value = arrays.drawn("trial.values", lambda draw, n: draw.uniform(-8.0, 8.0, n))
    faults = [
        {"kind": "link_loss", "probability": LOSS, "share": 1.0},
        {"kind": "link_delay", "between_ticks": [0, 3], "ordered": False, "share": 0.5},
    ]
    lab = Lab("synchroniser", arrays.cells, faults=faults, seed=seeds[0], check=None)
    lab.registers["value"] = value
    wrong, apart = np.zeros(len(value), dtype=np.int64), np.zeros(len(value), dtype=np.int64)
    neighbours = lab.lattice.neighbours
    rounds = [value]
    for _ in range(SYNCHRONISED_TICKS):
        own, gain = rounds[-1], np.zeros(len(value))
        for side in range(4):
            gain = gain + np.where(neighbours[:, side] >= 0, own[neighbours[:, side]] - own, 0.0)
        rounds.append(own + 0.2 * gain)
        registers = lab.step().registers
        pulse = registers["pulse"]
        wrong += registers["value"] != np.array(rounds)[pulse, np.arange(len(pulse))]
        there = np.where(neighbours >= 0, pulse[neighbours], pulse[:, None])
        apart = np.maximum(apart, abs(there - pulse[:, None]).max(axis=1))
    return Synchronised(
        np.add.reduceat(wrong, arrays.starts),
        np.maximum.reduceat(apart, arrays.starts),
        np.minimum.reduceat(pulse, arrays.starts),
    )
