"""What the springs under a parcel are like: where effects on the loads come in, settled when a kernel is compiled.

A surface's ``springs`` are None where all cells are equal springs at one height. What is answered here is all that a
kernel compiled for such a surface contains: constants, which the compiler folds away. ``uneven_springs`` answers for
surfaces with springs of their own. Which answer a call means follows from the type of the surface alone, so that no
kernel asks while it runs.
"""

from __future__ import annotations

from numba import types
from numba.extending import overload

from plant.kernels import layout as at

ANSWER = {"error_model": "numpy", "_nrt": False}
"""How answers are compiled: as ``jit.kernel`` does."""
LOAD_ZERO = 1e-12
"""A share of the mean load that rounding can't tell from none."""


def surface_under(surface, i):
    """The surface as parcel ``i`` feels it."""


def stiffness(surface, cell):
    """Rate of a cell's spring over the mean one's."""


def gap(surface, cell):
    """How far below the mean level a cell's spring ends, over the sag of one mean spring under the whole parcel."""


def note_gaps(surface, parcel, seg, mark):
    """Keep what the active supports' gaps add to the springs' plane; ``seg`` has their centroid."""


def plane_at(surface, seg, mx, my):
    """The springs' plane with the load's centre at (mx, my) from the centroid of the supports (eqs. 3-13).

    Returns (a, bx, by): the load share of a cell at r from the centroid is its stiffness times
    ``a + b . r`` less its gap.
    """


def negligible(surface, a0):
    """How far from a plane ``a0`` at the centroid a spring may end that rounding can't tell from touching it."""


def answer(question, own):
    """Let a function answer a question for all surfaces with springs of their ``own``, or for all without.

    Args:
        question: One of the functions above.
        own: For which of the two.

    Returns:
        A decorator of the function, which takes what the question takes.
    """

    def register(implementation):
        # not strict: the names of arguments that an answer has no use for need not agree
        @overload(question, jit_options=ANSWER, strict=False)
        def resolve(surface, *_):
            springs = dict(zip(surface.fields, surface.types, strict=True))["springs"]
            return None if isinstance(springs, types.NoneType) == own else implementation

        return implementation

    return register


@answer(surface_under, own=False)
def _same(surface, _i):
    return surface


@answer(stiffness, own=False)
def _equal(_surface, _cell):
    return 1.0


@answer(gap, own=False)
def _level(_surface, _cell):
    return 0.0


@answer(note_gaps, own=False)
def _no_gaps(_surface, _parcel, _seg, _mark):
    return


@answer(plane_at, own=False)
def _plane(_surface, seg, mx, my):
    bx, by = seg[at.PXX] * mx + seg[at.PXY] * my, seg[at.PXY] * mx + seg[at.PYY] * my
    return 1.0 / seg[at.N_ACTIVE], bx, by


@answer(negligible, own=False)
def _of_the_mean(_surface, a0):
    return LOAD_ZERO * a0
