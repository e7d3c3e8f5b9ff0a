"""Array layout shared by the contact kernels."""

from __future__ import annotations

from typing import Final

TOUCH_M: Final = 1e-9
"""Bodies nearer than this touch."""
NEAR_M: Final = 1e-7
"""Pairs as near, and as slow as ``Group.slow``, stay together."""

# ── pull: float64 (bodies, PULL_SIZE), what bounds a body's accelerations
PER_SLIP: Final = 0  # of a corner, over the fastest slip, 1/s
LIMIT: Final = 1  # of the same however large the slip, m/s^2
PUSH: Final = 2  # of a corner whatever the slip, m/s^2
RADIUS: Final = 3  # farthest corner from the centre of mass, m
UNLIMITED: Final = 4  # as PER_SLIP, but for what no limit holds for, 1/s
PULL_SIZE: Final = 5

# ── row: float64 (2 pairs, ROW_SIZE), a point at which two bodies touch, and the problem of impulses there
PX, PY = 0, 1  # in the world, m
NORMAL_X, NORMAL_Y = 2, 3  # unit normal from the first body to the second
SPACE: Final = 4  # free, m; negative where they overlap
AX, AY, BX, BY = range(5, 9)  # the point, from the first and from the second body's centre of mass, m
WANTED: Final = 9  # least motion of the second from the first, along the normal
ASIDE_WANTED: Final = 10  # motion wanted across: along the normal turned by 90 degrees
FRICTION: Final = 11  # Coulomb coefficient
HOLD: Final = 12  # not 0: what is wanted across is given whatever it takes
ROW_SIZE: Final = 13

# ── ends: int64 (2 pairs, 3), the two bodies of a row, and the pair
PAIR: Final = 2

# ── tally: int64 (TALLY_SIZE,), of the problems of islands
PROBLEMS: Final = 0  # solved
PIVOTED: Final = 1  # of them those that Newton steps left to Lemke's method
SWEPT: Final = 2  # of them those left to sweeps
SLIPPERY: Final = 3  # of them those solved without friction, as no solution with it was found
TALLY_SIZE: Final = 4

# ── left: float64 (LEFT_SIZE,), the most that was left
ERROR: Final = 0  # of velocities, m/s
OVERLAP: Final = 1  # of two bodies, m
PARTED: Final = 2  # m, overlap that was taken out of places at once
LEFT_SIZE: Final = 3

# ── marks of pairs
EVERY: Final = -1
"""All pairs, not only those with one mark."""
TOGETHER: Final = 1
HELD: Final = 1
SLIPPING: Final = 2
BEYOND: Final = 1e300
"""Farther than anything."""
