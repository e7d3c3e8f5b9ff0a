"""Array layout of the implicit solver, in addition to ``layout`` for parcels and supports.

Velocities are ``w = (Ux, Uy, l omega)`` with the parcel's radius of gyration l, and everything else is per kilogram, so
that the mass matrix is 1.
"""

from __future__ import annotations

from typing import Final

# ── law: float64 coefficients of one parcel's traction, per kilogram; a share is a cell's part of the weight
STIFFNESS: Final = 0  # 1/s
STIFFNESS_PER_SHARE: Final = 1  # 1/s
LIMIT: Final = 2  # m/s^2
LIMIT_PER_SHARE: Final = 3  # m/s^2
FREE_SPEED: Final = 4  # share of the surface speed
PUSH_PER_SHARE: Final = 5  # m/s^2
SET_VALUED: Final = 6  # 1 where the stiffness is infinite
ISOTROPIC: Final = 7  # 1 where both axes of a cell share one limit
VISCOUS: Final = 8  # 1/s, by slip, beside the limited part and without a limit
WHEEL: Final = 9  # inertia of a wheel over the parcel's mass, where wheels feel what they pull
LOCATED: Final = 10  # how wheels change branch where that is located, or 0 where it isn't
CAPTURES: Final = 11  # how chatter is replaced by motion along its surface, or 0 where it isn't
STATIC_RATIO: Final = 12  # limit of a wheel that sticks over that of one that slips
LAW_SIZE: Final = 13
KINKS: Final = 1.0  # each wheel by itself, and its force is continuous
JUMPS: Final = 2.0  # each wheel by itself, and its force jumps where its slip turns round
CONES: Final = 3.0  # the wheels of a cell together: the size of their force jumps where their slip ends
BY_SERIES: Final = 1.0  # that motion is the exact solver's Taylor series
BY_STEPS: Final = 2.0  # it is stepped as other motion is, every wheel under the mean of its loads
BY_MODES: Final = (
    3.0  # likewise, every wheel once for each mode: its branch of the law may differ from mode to mode
)

# ── pace: float64 settings and memory of one parcel
GYRATION: Final = 0  # m
FIXED: Final = 1  # longest step, s, where steps are fixed; else 0
TOLERANCE: Final = 2  # m at the footprint
NEXT: Final = 3  # step to try next, s (changes as the parcel moves)
CROWD: Final = 4  # support changes of late; where they are located, those in a row at one instant (changes)
OUTRUN: Final = 5  # 1 while the parcel outruns a wheel that the law takes to be faster (changes)
STEPS_LEFT: Final = 6  # of those allowed so far (changes)
STEPS_PER_SECOND: Final = 7  # allowed; infinite where steps are fixed
LOCATES: Final = 8  # 1 where supports are held over a step, and their changes are located
NOW: Final = 9  # time of the instant at which accelerations are asked for, s (changes)
PACE_SIZE: Final = 10

# ── wheels: float64 (capacity, .), one row for each cell that carries load and isn't coasting
AX, AY, SX, SY, BX, BY, CX, CY, GX, GY, LX, LY, K, SUMMED, SIDE_X, SIDE_Y, CELL = range(17)
SLIPS, WAS_X, WAS_Y, OWN_X, OWN_Y, OWN_K, ONE_BEFORE, TWO_BEFORE = range(17, 25)
"""Underside above the cell: ``v = (w0 + AX w2, w1 + AY w2)``; free speeds S; ``b`` and ``c`` along each axis, equal
where both axes share one limit; multipliers L. Forces without a limit are ``G - K v``: the law's push and viscous part,
and other resistance to the underside's motion. ``SUMMED`` is the size of the terms that the free speeds are sums of:
they may cancel, their rounding does not. ``SIDE_X`` and ``SIDE_Y`` are 1 or -1 where the wheel sticks
as the step begins and slips that way at its end, else 0. ``CELL`` is which cell it is. ``SLIPS`` is 1 where both wheels
of a cell slip, which share one limit; ``WAS_X`` and ``WAS_Y`` are then their slip as the part begins. ``OWN_X`` and
``OWN_Y``: the part of G by which the wheel itself is pulled back, ``OWN_K`` that of K. ``ONE_BEFORE`` and
``TWO_BEFORE``: size of their slip as the parts before began, of the finest cut."""
WHEEL_SIZE: Final = 25

# ── first: float64 findings about a step: the change of velocity in its first part, then
REGIME: Final = 3  # which wheels are at their limits there
SLIPPED: Final = 4  # the largest slip in the step of a wheel that sticks where it begins, m/s
OUTSIDE: Final = 5  # how far a captured group's fraction leaves [0, 1] in it, at most
ERROR: Final = 6  # that of the step extrapolated last, m
CEASED: Final = (
    7  # parts of it, cut most finely, by whose end a cell's slip had ended; more than there are if none had
)
TURNED: Final = 8  # 1 where the slip of a cell turned in one of them so far that it may have ended within
ENDS: Final = 9  # where in the last of them, in parts, the first slip that ends there does; 1 if none does
LED_ON: Final = 10  # how far such slips were led on beyond their end, at most, in m over a part's seconds
FIRST_SIZE: Final = 11

# ── slowing: rows of the cells whose wheels a parcel has slowed: D along x and y, m/s, and their integrals, m
SLOWED: Final = 4
LISTED, WRITTEN = range(2)
"""In ``slowing.ctl``: rows in use; rows handed over."""

# ── further statuses
NOT_SOLVED: Final = 7
UNBALANCED: Final = 8
"""Loads and traction don't agree yet: solve again. Never a parcel's status."""

UNITY: Final = 1.0
ONE_PART: Final = 1
"""Named, for the compiler: see ``layout.ZERO``."""
