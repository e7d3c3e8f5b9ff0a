"""Rollers that resist being rolled (effect ``roller_drag``): ``-d N v`` along each wheel's free direction.

Only a solver whose scene asks for it imports this; kernels for free rollers are compiled without it.
"""

from __future__ import annotations

from plant.kernels.common.hooks import implements
from plant.kernels.implicit.traction_hooks import drag


@implements(drag, "drag", own=True)
def _drag(surface, share):
    return surface.drag * share
