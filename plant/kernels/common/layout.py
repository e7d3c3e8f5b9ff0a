"""Array layout shared by the kernels.

Compiled code reads these names as constants. Lengths are measured from the parcel's centre of mass at the start
of a step (``X0``) or from the centroid of the supports (``c``), never from the origin: digits survive far away.
"""

from __future__ import annotations

from typing import Final

ZERO: Final = 0
"""Where a count starts. A number or truth value written out in a kernel is a type of its own to the compiler, which
compiles what is called with it once more; a named one is not."""
ONE: Final = 1
NO_CELL: Final = -1
COMPLETE: Final = True
UNDONE: Final = False
NOTHING: Final = 0.0
FORWARD: Final = 1.0
BACKWARD: Final = -1.0

MAX_ORDER: Final = 22
"""Highest Taylor order of a step."""
MAX_GROUPS: Final = 3
"""A rigid parcel has three freedoms, so at most three independent sliding surfaces."""
MODES: Final = 1 << MAX_GROUPS
"""Support sets whose motions mix: bit h of a mode's number says that captured group h is on the far side of its
surface. Without captured groups mode 0 is all there is."""

# ── par: float64 constants of one parcel on one surface
KAPPA: Final = 0  # slope of the law's force by slip, per kilogram, 1/s: mu g where it is viscous
MASS_OVER_INERTIA: Final = 1  # 1/m^2
RADIUS: Final = 2  # farthest corner from the centre of mass, m
RATE: Final = 3  # 1 / motor time constant, 1/s; 0 without motors
TOLERANCE: Final = 4  # m at the footprint
CAPTURE: Final = 5  # m
PITCH: Final = 6  # m
ORIGIN_X: Final = 7  # centre of cell (0, 0), m
ORIGIN_Y: Final = 8
ON_SURFACE: Final = 9  # a distance that rounding can't tell from zero, m
ON_LINE: Final = 10  # how far off a line of supports a centre of mass still stands, m
MEMORY: Final = 11  # how long an error in velocity lasts, s
GAP: Final = 12  # mean time between events of late, s (changes as the parcel moves)
# the law's force per kilogram, over KAPPA: clamp(resistance (s - v), -limit, +limit) + push, m/s; resistance and limit
# are a coefficient times the cell's share of the weight, plus a constant
PER_SHARE: Final = 13  # of the resistance
CONSTANT: Final = 14
LIMIT_PER_SHARE: Final = 15  # m/s
LIMIT: Final = 16  # m/s; infinite: no limit
FREE_SPEED: Final = 17  # s as a share of the wheel's surface speed
PUSH_PER_SHARE: Final = 18  # along the wheel's motion, m/s
PAR_SIZE: Final = 19

# ── y: float64 state of one parcel
X, Y, THETA, UX, UY, OMEGA = range(6)

# ── mem: int64 (capacity, MEM_COLUMNS), the cells under the parcel or on its edge
CELL, EDGE, GROUP, SIDE, MARK = range(5)
"""``MARK + m`` is the cell's mark in mode m. ``SIDE`` is 0 where the cell isn't captured; a captured one sits on
``EDGE`` and is under the parcel on the far side of ``GROUP``'s surface (1) or on its near side (-1)."""
BRANCH: Final = MARK + MODES
"""``BRANCH + 2 m`` and the next: on which branch of the law its wheels along x and y are in mode m: 0 within the limit,
1 or -1 at it, pulling that way."""
MEM_COLUMNS: Final = BRANCH + 2 * MODES
ACTIVE: Final = 0  # carries load
LIFTED: Final = 1  # under the parcel, but the plane of the springs is above it
ABSENT: Final = 2  # captured, and in this mode not under the parcel

# ── ctl: int64 counters and flags of one parcel
N_MEMBERS, N_GROUPS, STATUS, N_EVENTS, N_STEPS, TIP_A, TIP_B, N_LOGGED, N_CAPTURES = range(9)
CULPRIT, N_CHANGES, N_CROSSED, OUTRUN, N_LAST = range(9, 14)
"""``OUTRUN`` is 0, or 1 and up for a wheel that the parcel outruns: ``outrun.watch``."""
CTL_SIZE: Final = 14

# ── statuses
MOVING: Final = 0
TIPPED: Final = 1
TOO_MANY_EVENTS: Final = 2
NOT_FINITE: Final = 3
NO_LOADS: Final = 4
ENDLESS_STEPS: Final = 5
STOPPED: Final = 6
"""Somebody asked for the call to end; see ``plant.stop``."""

# ── seg: float64 constants of one support set, measured about its centroid c
N_ACTIVE: Final = 0  # sum of their stiffnesses: how many, where springs are equal
CX, CY = 1, 2  # c - X0
PXX, PXY, PYY = 3, 4, 5  # (pseudo-)inverse of sum k r r'
RANK: Final = 6
LINE_X, LINE_Y = 7, 8  # unit normal of the line of supports, where the rank is 1
UNIFORM: Final = 9  # 1 where every wheel resists in proportion to its load alone: viscous, and none coasts
S0X, S0Y, S1X, S1Y, C2 = range(10, 25, 3)
"""Sums over the wheels that pull, each linear in the loads' plane: three coefficients, of a0, bx and by. The resistance
along x and along y, its moments about the centroid (S1X: what pulls along x, times the lever y), its turning."""
STEADY: Final = 25  # sums of what drives, by the steady part of the wheels' speed, ...
DECAY: Final = 34  # ... and by the part that decays with the motors
DX, DY, T = range(0, 9, 3)
"""From there on: along x, along y, and their moment about the centroid."""
SEG_SIZE: Final = 43

# ── grp: float64 (MAX_GROUPS, .), a group's surface: sigma = B + A_C cos + A_S sin + A_1 E1 + A_2 E2, see series.taylor
B, A_C, A_S, A_1, A_2, N_CELLS = range(6)
GRP_SIZE: Final = 6

# ── ser: float64 (rows, MAX_ORDER + 4), Taylor coefficients: what all modes share ...
S_X, S_Y, S_TH, S_UX, S_UY, S_OM, S_C, S_S, S_E1, S_E2, S_EXP, S_VX, S_VY, S_SHARE = range(14)
"""``S_VX`` and ``S_VY``: velocity of the parcel's underside above ``X0``, only where single wheels are looked at.
``S_SHARE + 2**h`` is the fraction of the motion that is on group h's far side, ``S_SHARE + b`` the product of the
fractions of all groups whose bits are set in b."""
# ... and, from row MODES_AT + m * MODE_ROWS on, what belongs to mode m
MODES_AT: Final = S_SHARE + MODES
(
    M_A0,
    M_BX,
    M_BY,
    M_XIX,
    M_XIY,
    M_DX,
    M_DY,
    M_T,
    M_CC,
    M_DBX,
    M_DBY,
    M_TB,
    M_S0X,
    M_S0Y,
    M_S1X,
    M_S1Y,
    M_QX,
    M_QY,
    M_C2,
    M_AX,
    M_AY,
    M_AL,
) = range(22)
MODE_ROWS: Final = 22
SER_ROWS: Final = MODES_AT + MODES * MODE_ROWS
SER_COLUMNS: Final = MAX_ORDER + 4

# ── found and logged events: float64 (., 4)
EV_TIME, EV_KIND, EV_CELL, EV_EDGE = range(4)
ENTER: Final = 0
LEAVE: Final = 1
UNLOAD: Final = 2
TOUCH: Final = 3
ONLY_NEAR: Final = 4
ONLY_FAR: Final = 5
CORNER: Final = 6
LINE: Final = 7
CAPTURE_BEGINS: Final = 8
TIP: Final = 10
OUTRAN: Final = 11
SWITCH: Final = 12
"""A wheel reaches another branch of the law, or is outrun, or no longer: ends the step, and nothing else."""
RAMP: Final = 13
"""A cell's share of the load begins or ceases to ramp, on wheels with a width: ends the step, and nothing else."""
