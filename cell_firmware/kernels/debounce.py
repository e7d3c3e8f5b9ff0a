"""Debouncing of presence bits: a change is accepted after several readings in a row."""

from __future__ import annotations

from cell_firmware.kernels.clock import count_before, due
from cell_firmware.kernels.jit import BOOLEAN, INTEGER, entry, kernel, read, written


@kernel
def debounced(ticks, bit, believed, count):
    """The accepted bit and the number of readings that differed from it, after a reading."""
    if bit == believed:
        return believed, 0
    if count + 1 >= ticks:
        return bit, 0
    return believed, count + 1


@entry(
    INTEGER, INTEGER, INTEGER, INTEGER, read("i8", 1), read("i8", 1), read("i8", 1), BOOLEAN, read("?", 2),
    written("?", 2), written("i8", 2), written("?", 2),
)  # fmt: skip
def debounce(
    ticks, window, period_ns, window_ns, ppb, phase_ns, alive, every, bits, believed, counts, presence
):
    """Debounce the readings of an exchange.

    Args:
        ticks: Readings in a row after which a change is accepted.
        window: In which cells with clocks of their own read.
        period_ns: Of these clocks.
        window_ns: Of the exchange.
        ppb: ``(n,)``, errors of the clocks; none where all cells read in every exchange.
        phase_ns: ``(n,)``, their first instants; likewise.
        alive: Rows of live cells.
        every: Whether all cells are alive, whatever ``alive`` says.
        bits: ``(n, sensors)``, the readings.
        believed: ``(n, sensors)``, the accepted bits; changed in place.
        counts: ``(n, sensors)``, readings in a row that differ from them; changed in place.
        presence: ``(n, sensors)``; is filled with the accepted bits.

    Returns:
        How many changes of live cells were given up.
    """
    bounces, next_alive = 0, 0
    for i in range(len(bits)):
        lives = every or (next_alive < len(alive) and alive[next_alive] == i)
        next_alive += lives
        fresh = True
        if len(ppb):
            before = count_before(period_ns, ppb[i], phase_ns[i], window * window_ns)
            fresh = due(period_ns, window_ns, ppb[i], phase_ns[i], window, before) >= 0
        for sensor in range(bits.shape[1]):
            if fresh:
                if lives and bits[i, sensor] == believed[i, sensor] and counts[i, sensor] > 0:
                    bounces += 1
                believed[i, sensor], counts[i, sensor] = debounced(
                    ticks, bits[i, sensor], believed[i, sensor], counts[i, sensor]
                )
            presence[i, sensor] = believed[i, sensor]
    return bounces
