"""Where each quantity lives in the arrays that the kernels share.

Compiled code reads these names as constants. Lengths are measured from the parcel's centre of mass at the start
of a step (``X0``) or from the centroid of the supports (``c``), never from the origin: digits survive far away.
"""

from __future__ import annotations

from typing import Final

ZERO: Final = 0
"""Where a count starts. A number or truth value written out in a kernel is a type of its own to the compiler, which
compiles what is called with it once more; a named one is not."""
NO_CELL: Final = -1
COMPLETE: Final = True
UNDONE: Final = False

MAX_ORDER: Final = 22
"""Highest Taylor order of a step."""
MAX_GROUPS: Final = 3
"""A rigid parcel has three freedoms, so at most three independent sliding surfaces."""

# ── par: float64 constants of one parcel on one surface
KAPPA: Final = 0  # mu g, 1/s
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
PAR_SIZE: Final = 13

# ── y: float64 state of one parcel
X, Y, THETA, UX, UY, OMEGA = range(6)

# ── mem: int64 (capacity, 4), the cells under the parcel; share: float64 (capacity, 2), loads of the captured ones
# over the weight: share[i, BASE] + share[i, SHARE] f of its group (SHARE < 0 for a cell that unloads as f grows)
SHARE, BASE = range(2)
CELL, MARK, EDGE, GROUP = range(4)
ACTIVE: Final = 0  # carries load
LIFTED: Final = 1  # under the parcel, but the plane of the springs is above it
CAPTURED: Final = 2  # sits on the edge and carries a fraction (sliding mode)

# ── ctl: int64 counters and flags of one parcel
N_MEMBERS, N_GROUPS, STATUS, N_EVENTS, N_STEPS, TIP_A, TIP_B, N_LOGGED, N_CAPTURES = range(9)
CULPRIT, N_CHANGES, N_CROSSED = range(9, 12)
CTL_SIZE: Final = 12

# ── statuses
MOVING: Final = 0
TIPPED: Final = 1
TOO_MANY_EVENTS: Final = 2
NOT_FINITE: Final = 3
NO_LOADS: Final = 4

# ── seg: float64 constants of one support set, measured about its centroid c
N_ACTIVE: Final = 0
CX, CY = 1, 2  # c - X0
PXX, PXY, PYY = 3, 4, 5  # (pseudo-)inverse of sum r r'
RANK: Final = 6
LINE_X, LINE_Y = 7, 8  # unit normal of the line of supports, where the rank is 1
W0, W1X, W1Y, W2XX, W2XY, W2YY, G0, G1X, G1Y = range(9, 18)  # moments of the driven wheels
STEADY: Final = 18  # moments of wheel velocity: steady part ...
DECAY: Final = 27  # ... and the part that decays with the motors
K0X, K0Y, K1XX, K1XY, K1YX, K1YY, T0, T1X, T1Y = range(9)
DRIVEN: Final = 36  # 1 where every wheel under the parcel is driven
SEG_SIZE: Final = 37

# ── grp: float64 (MAX_GROUPS + 1, .), what a unit load on a captured group adds
S_RX, S_RY, S_W, S_WRX, S_WRY, S_WRR, S_VX, S_VY, S_RV, S_BX, S_BY, S_RB = range(12)
# its surface: sigma = B + A_C cos + A_S sin + A_1 E1 + A_2 E2, see series.taylor
B, A_C, A_S, A_1, A_2 = range(12, 17)
S_SUM: Final = 17
GRP_SIZE: Final = 18
FIXED: Final = MAX_GROUPS
"""Row of the loads that captured cells carry whatever their group's fraction."""

# ── ser: float64 (rows, MAX_ORDER + 4), Taylor coefficients
(
    S_X,
    S_Y,
    S_TH,
    S_UX,
    S_UY,
    S_OM,
    S_C,
    S_S,
    S_E1,
    S_E2,
    S_A0,
    S_BX_,
    S_BY_,
    S_DX,
    S_DY,
    S_T,
    S_XIX,
    S_XIY,
    S_CC,
    S_EXP,
    S_DBX,
    S_DBY,
    S_TB,
    S_S0,
    S_BBX,
    S_BBY,
    S_S1X,
    S_S1Y,
    S_C2,
    S_F,
) = range(30)
SER_ROWS: Final = 29 + MAX_GROUPS
SER_COLUMNS: Final = MAX_ORDER + 4

# ── found and logged events: float64 (., 4)
EV_TIME, EV_KIND, EV_CELL, EV_EDGE = range(4)
ENTER: Final = 0
LEAVE: Final = 1
UNLOAD: Final = 2
TOUCH: Final = 3
FRACTION_ZERO: Final = 4
FRACTION_ONE: Final = 5
CORNER: Final = 6
LINE: Final = 7
CAPTURE_BEGINS: Final = 8
CAPTURE_ENDS: Final = 9
TIP: Final = 10
