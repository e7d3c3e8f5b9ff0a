"""Hooks of effects on what wheels pull with, in the kernels that list the wheels (``grasp``).

The defaults compile to nothing. ``roller_drag`` implements ``drag`` for surfaces with ``drag``, ``uneven_friction``
``factor`` for surfaces with ``factors``.
"""

from __future__ import annotations

from plant.kernels.common.hooks import implements


def drag(surface, share):
    """Resistance of the rollers to the underside's motion above a cell under a ``share`` of the weight, 1/s."""


def factor(surface, cell):
    """Traction by load of a cell's wheels over the law's (x, y)."""


@implements(factor, "factors", own=False)
def _alike(_surface, _cell):
    return 1.0, 1.0


@implements(drag, "drag", own=False)
def _free(_surface, _share):
    return 0.0
