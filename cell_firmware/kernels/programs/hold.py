"""Time to live of messages, as ``cell_firmware.toolkit.hold`` defines it, for one side of a cell."""

from __future__ import annotations

from cell_firmware.kernels.jit import kernel


@kernel
def aged(received, count, ttl_periods):
    """For how many periods, the current one included, a side's message is valid; 0 without a message."""
    return ttl_periods if received else max(count, 1) - 1
