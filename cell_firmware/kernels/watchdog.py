"""A cell's watchdog, as ``cell_firmware.effects.cop`` defines it."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import kernel

WATCHDOG = np.dtype(
    [
        ("instants", "<i8"),
        ("served_ns", "<i8"),
        ("starts_ns", "<i8"),
        ("drive", "<f8", (2,)),
        ("hangs", "<i8"),
        ("resets", "<i8"),
        ("hung", "u1"),
    ],
    align=True,
)
"""State of a cell's watchdog."""


@kernel
def bite_ns(k, watch):
    """Time at which a watchdog that is not served any more resets its cell, in the cell's own time, ns."""
    return -(-(watch.served_ns + k.timeout_ns) // k.divider_ns) * k.divider_ns


@kernel
def times_out(k, watch):
    """Whether the program served its watchdog too long ago."""
    at_ns = watch.instants * k.period_ns
    return at_ns - watch.served_ns >= k.timeout_ns and at_ns >= bite_ns(k, watch)


@kernel
def periods_left(k, watch):
    """Control periods of the cell, the next one included, before the first in which its watchdog can time out."""
    return (watch.served_ns + k.timeout_ns - watch.instants * k.period_ns + k.period_ns - 1) // k.period_ns


@kernel
def time_out(k, watch):
    """Reset a cell whose program served its watchdog too long ago. Returns whether it was reset."""
    if not times_out(k, watch):
        return False
    watch.starts_ns = bite_ns(k, watch) + k.reboot_ns
    watch.served_ns = watch.starts_ns
    watch.hung = 0
    watch.drive[0] = 0.0
    watch.drive[1] = 0.0
    watch.resets += 1
    return True


@kernel
def runs(k, watch):
    """Whether a cell's program runs in its next control period."""
    return watch.hung == 0 and watch.instants * k.period_ns >= watch.starts_ns


@kernel
def note(k, watch, drive, raised, served):
    """Note the control period of a program that ran; ``drive``, ``(2,)``, is held if it raised."""
    if raised:
        watch.hung = 1
        watch.hangs += 1
        drive[0] = watch.drive[0]
        drive[1] = watch.drive[1]
        return
    watch.drive[0] = drive[0]
    watch.drive[1] = drive[1]
    if served:
        watch.served_ns = watch.instants * k.period_ns
