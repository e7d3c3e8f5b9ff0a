"""What a protocol's messages take: how many, of how many bytes, and how much of a serial line they would fill."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    import numpy as np

    from deploy.scene import Scene


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinkLoad:
    """Messages between the cells of a run.

    Attributes:
        sent: Messages that programs gave to a line with a neighbour at its end.
        heard: Messages that they were given.
        sent_per_cell_tick: Sent by a living cell in a tick, to all its sides together.
        heard_per_cell_tick: Likewise.
        message_bytes: A message's fields, packed.
        line_bytes: What it takes on a serial line: with its check byte.
        line_bytes_per_cell_tick: What a cell gives its lines in a tick, if all of it goes.
        on_lines: Whether the scene has serial lines; otherwise this is what they would have to carry.
        baud: Of those lines.
        line_capacity_bytes_per_tick: What one direction of a line between two cells carries in a tick.
        line_load: Bytes given to a direction of a line, by what it carries: above 1 not every message goes out.
    """

    sent: int
    heard: int
    sent_per_cell_tick: float
    heard_per_cell_tick: float
    message_bytes: int
    line_bytes: int
    line_bytes_per_cell_tick: float
    on_lines: bool
    baud: int
    line_capacity_bytes_per_tick: float
    line_load: float


def link_load(
    scene: Scene,
    message: np.dtype[np.void] | None,
    tally: Mapping[str, int],
    cell_ticks: int,
    link_ticks: int,
) -> LinkLoad | None:
    """What the messages of a run took; None for firmware without any, or a run of no ticks.

    Args:
        scene: What ran.
        message: The type of its messages.
        tally: What its cells counted.
        cell_ticks: The ticks of every cell in which it lived, summed.
        link_ticks: Those of every direction of a link whose sender lived.
    """
    if message is None or not cell_ticks:
        return None
    from cell_firmware.effects.serial import SerialSpec
    from cell_firmware.serial.frames import bytes_of

    lines = scene.effects.serial or SerialSpec()
    settings = lines.settings(scene.cells.period_ns)
    capacity = scene.tick_ns / settings.byte_ns
    if settings.polled:
        capacity = min(capacity, settings.polled_bytes * scene.tick_ns / settings.period_ns)
    if settings.dwell_periods is not None:
        capacity /= 4  # one SCI for four sides
    sent, heard = tally.get("messages.sent", 0), tally.get("messages.heard", 0)
    size = bytes_of(message)
    return LinkLoad(
        sent=sent,
        heard=heard,
        sent_per_cell_tick=sent / cell_ticks,
        heard_per_cell_tick=heard / cell_ticks,
        message_bytes=size - 1,
        line_bytes=size,
        line_bytes_per_cell_tick=sent * size / cell_ticks,
        on_lines=scene.effects.serial is not None,
        baud=lines.baud,
        line_capacity_bytes_per_tick=capacity,
        line_load=sent * size / link_ticks / capacity if link_ticks else 0.0,
    )
