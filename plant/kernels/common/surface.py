"""Cells and wheels as kernel data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Springs(NamedTuple):
    """The cells' springs under one parcel, where they are not all equal (see ``plant.kernels.effects.uneven_springs``).

    Attributes:
        rate: ``(n,)`` over the mean.
        gap_m: ``(n,)`` how far below the mean level they end.
        per_m: mean rate over the parcel's weight, 1/m.
        span: widest gap or its opposite, over the sag of one mean spring under the whole parcel.
        moments: ``(3,)`` scratch: ``sum k g`` and ``sum k g r`` of the active supports.
    """

    rate: Floats
    gap_m: Floats
    per_m: float
    span: float
    moments: Floats


class AllSprings(NamedTuple):
    """The cells' springs as each of m parcels feels them.

    Attributes:
        rate: as ``Springs.rate``.
        gap_m: likewise.
        per_m: ``(m,)``.
        span: ``(m,)``.
        moments: ``(m, 3)``.
    """

    rate: Floats
    gap_m: Floats
    per_m: Floats
    span: Floats
    moments: Floats


class Edges(NamedTuple):
    """How much of each cell is under one parcel, where wheels have a width (see ``plant.kernels.effects.wheel_edges``).

    Attributes:
        width_m: over which a cell comes to be under a parcel.
        share: ``(capacity,)`` scratch: of the cell in each row of ``Parcel.mem``.
    """

    width_m: float
    share: Floats


class AllEdges(NamedTuple):
    """Wheel edges of all m parcels.

    Attributes:
        width_m: as ``Edges.width_m``.
        share: ``(m, capacity)``.
    """

    width_m: float
    share: Floats


class Rollers(NamedTuple):
    """The rollers of all wheels as one parcel meets them (see ``plant.kernels.effects.roller_impacts``).

    Attributes:
        spacing_m: slip from one to the next.
        impulse_m_s: what one gives, over the load on the wheel in shares of the parcel's weight, per kilogram.
        start: ``(n, 2)`` how far each wheel had turned at the start since a roller passed, in spacings: [0, 1).
        passed: ``(n, 2)`` slip along each wheel's axis since then, in spacings, less the rollers that passed.
    """

    spacing_m: float
    impulse_m_s: float
    start: Floats
    passed: Floats


class AllRollers(NamedTuple):
    """Wheel rollers of all m parcels.

    Attributes:
        spacing_m: as ``Rollers.spacing_m``.
        impulse_m_s: as ``Rollers.impulse_m_s``.
        start: as ``Rollers.start``.
        passed: ``(m, n, 2)``.
    """

    spacing_m: float
    impulse_m_s: float
    start: Floats
    passed: Floats


class Stiction(NamedTuple):
    """How each wheel holds one parcel, where static friction exceeds the kinetic one.

    See ``plant.kernels.effects.stiction``.

    Attributes:
        ratio: of the static to the kinetic limit.
        grips: ``(capacity, 3)`` cell, and how each of its wheels slips.
        counts: ``(2,)`` rows of ``grips`` and of ``begun``.
        begun: ``(capacity, 3)`` scratch: ``grips`` where a step begins.
        found: ``(capacity, 3)`` scratch: that at the end of the part just solved.
        limits: ``(capacity, 2)`` scratch: kinetic limits of the wheels listed.
        caught: ``(capacity, 2)`` scratch: wheels that changed within the part.
    """

    ratio: float
    grips: Integers
    counts: Integers
    begun: Integers
    found: Integers
    limits: Floats
    caught: Integers


class AllStiction(NamedTuple):
    """How each wheel holds each of m parcels.

    Attributes:
        ratio: as ``Stiction.ratio``.
        grips: ``(m, capacity, 3)``.
        counts: ``(m, 2)``.
        begun: ``(m, capacity, 3)``.
        found: ``(m, capacity, 3)``.
        limits: ``(m, capacity, 2)``.
        caught: ``(m, capacity, 2)``.
    """

    ratio: float
    grips: Integers
    counts: Integers
    begun: Integers
    found: Integers
    limits: Floats
    caught: Integers


class Transfer(NamedTuple):
    """Shift of one parcel's loads by traction below its centre of mass (see ``plant.kernels.effects.load_transfer``).

    Attributes:
        lever_s2: height of the centre of mass over the gravitational acceleration.
        shift: ``(MODES, 2)`` from the centre of mass to the load's centre in each mode, m.
        change: ``(MODES, 4)`` scratch: a shift before a correction, and the correction, m.
        memory: ``(3,)`` scratch: passes of the balance so far, what it was off by, share of a correction.
    """

    lever_s2: float
    shift: Floats
    change: Floats
    memory: Floats


class AllTransfer(NamedTuple):
    """Shift of all m parcels' loads.

    Attributes:
        lever_s2: ``(m,)``.
        shift: ``(m, MODES, 2)``.
        change: ``(m, MODES, 4)``.
        memory: ``(m, 3)``.
    """

    lever_s2: Floats
    shift: Floats
    change: Floats
    memory: Floats


class Surface(NamedTuple):
    """The cells and their wheels, as the kernels read them.

    What is None by default belongs to effects: a kernel is compiled for what is there, and for nothing else.
    """

    pos: Floats
    grid: NDArray[np.int64]
    steady: Floats
    decay: Floats
    grip: Floats
    springs: Springs | AllSprings | None = None
    edges: Edges | AllEdges | None = None
    rollers: Rollers | AllRollers | None = None
    drag: float | None = None
    """Of the rollers under the whole weight, 1/s (see ``plant.kernels.effects.roller_drag``)."""
    stiction: Stiction | AllStiction | None = None
    factors: Floats | None = None
    """``(n, 2)`` traction of each wheel over the law's (see ``plant.kernels.effects.uneven_friction``)."""
    transfer: Transfer | AllTransfer | None = None
