"""Symmetries of a world: states that are mirrored or turned are the same state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from bus.lattice import Lattice
from deploy.studies.adversary.spec import Act
from deploy.studies.adversary.world import DEAD, Node

if TYPE_CHECKING:
    from deploy.studies.adversary.transitions import Key, Transitions

_SIDES: Final = ((1, 0), (0, 1), (-1, 0), (0, -1))
_TURNS: Final = tuple(
    (a, b, c, d)
    for a, b, c, d in (
        (0, -1, 1, 0), (-1, 0, 0, -1), (0, 1, -1, 0), (-1, 0, 0, 1), (1, 0, 0, -1), (0, 1, 1, 0), (0, -1, -1, 0),
    )
)  # fmt: skip
"""Matrices of the turns and reflections of a square, but for the identity."""


@final
class Symmetry:
    """One turn or reflection that maps a lattice to itself.

    Cells' states are compared as they are, except that arrays with four items a cell, one a side, are permuted. Whether
    the program is symmetric is not assumed: ``agrees`` compares each transition with its image.

    Args:
        cells: Image of each cell.
        sides: Image of each side.
        transitions: Transitions of the world's cells.

    Attributes:
        cells: As given.
    """

    def __init__(self, cells: Sequence[int], sides: Sequence[int], transitions: Transitions) -> None:
        self.cells = cells
        self._sides = sides
        self._from = [0] * (4 * len(cells))
        for cell, there in enumerate(cells):
            for side, to in enumerate(sides):
                self._from[4 * there + to] = 4 * cell + side
        self._link = [4 * cells[i // 4] + sides[i % 4] for i in range(4 * len(cells))]
        self._inverse = [0] * len(cells)
        for cell, there in enumerate(cells):
            self._inverse[there] = cell
        self._back = [sides.index(side) for side in range(4)]
        self._transitions = transitions
        self._images: dict[int, int] = {DEAD: DEAD}

    def image_of_state(self, number: int) -> int:
        """Return the number of a cell's state with its sides permuted."""
        found = self._images.get(number)
        if found is None:
            state = self._transitions.state((number,))
            turned: dict[str, Any] = {
                name: array[:, self._back] if array.ndim > 1 and array.shape[1] == 4 else array
                for name, array in state.items()
            }
            (found,) = self._transitions.numbers(
                {name: np.ascontiguousarray(a) for name, a in turned.items()}
            )
            self._images[number] = found
        return found

    def image_of_key(self, key: Key) -> Key:
        """Return the transition of the image of a cell."""
        inbox = [0] * 4
        for side, message in enumerate(key[3:]):
            inbox[self._sides[side]] = message
        return (self.cells[key[0]], self.image_of_state(key[1]), key[2], *inbox)  # pyright: ignore[reportReturnType]

    def agrees(self, keys: Sequence[Key]) -> bool:
        """Whether the images of these transitions are transitions of the program."""
        images = [self.image_of_key(key) for key in keys]
        steps = self._transitions.steps((*keys, *images))
        for key, image in zip(keys, images, strict=True):
            step, other = steps[key], steps[image]
            sent = [0] * 4
            for side, message in enumerate(step.sent):
                sent[self._sides[side]] = message
            if tuple(sent) != other.sent or self.image_of_state(step.state) != other.state:
                return False
            if bool(step.failure) != bool(other.failure):
                return False
        return True

    def image_of_act(self, act: Act) -> Act:
        """Return a fault of the image of its cell or link."""
        of_cell = act.kind in ("death", "repair")
        return act._replace(place=self.cells[act.place] if of_cell else self._link[act.place])

    def image(self, node: Node) -> Node:
        """Return the image of a state."""
        return node._replace(
            states=tuple(self.image_of_state(node.states[cell]) for cell in self._inverse),
            arriving=tuple(node.arriving[link] for link in self._from),
            late=tuple(sorted((left, self._link[link], message) for left, link, message in node.late)),
            down=tuple(sorted((self._link[link], left) for link, left in node.down)),
        )


def is_group(symmetries: Sequence[Symmetry]) -> bool:
    """Whether the identity and these symmetries are closed under composition."""
    there = {tuple(one.cells) for one in symmetries}
    identity = tuple(range(len(symmetries[0].cells))) if symmetries else ()
    return all(
        composed in there or composed == identity
        for one in symmetries
        for other in symmetries
        if (composed := tuple(one.cells[cell] for cell in other.cells))
    )


def symmetries_of(lattice: Lattice, transitions: Transitions, covered: Sequence[int]) -> list[Symmetry]:
    """Return the turns and reflections of a lattice that agree with the cells' first states and covered cells."""
    found: list[Symmetry] = []
    for cells, sides in _automorphisms(lattice):
        one = Symmetry(cells, sides, transitions)
        begins = all(
            one.image_of_state(transitions.initial[cell]) == transitions.initial[there]
            and (cell in covered) == (there in covered)
            for cell, there in enumerate(cells)
        )
        if begins:
            found.append(one)
    return found


def _automorphisms(lattice: Lattice) -> Iterator[tuple[list[int], list[int]]]:
    places = np.array(lattice.cells)
    for a, b, c, d in _TURNS:
        matrix = np.array([[a, b], [c, d]])
        turned = places @ matrix.T
        turned = turned - turned.min(axis=0) + places.min(axis=0)
        names = [(row, column) for row, column in turned.tolist()]
        if set(names) == set(lattice.cells):
            sides = [_SIDES.index(tuple((matrix @ np.array(step)).tolist())) for step in _SIDES]
            yield [lattice.index(name) for name in names], sides
