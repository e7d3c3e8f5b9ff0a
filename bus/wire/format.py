"""Wire format interface: frames to keys and payloads, and back.

A wire format divides the cells into *units*, each with its own keys: a cell in the format ``per_cell``, a shard in
the others. Messages between shards have keys of their own, or are *relayed*: a unit's drive brings the messages that
its cells send, and the coordinator passes the messages on with the next senses. Where messages have keys, the format
divides a shard's border links into *parts*: a border between two shards, or a single link. A format that relays has no
parts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from bus.errors import StateError
from bus.partition import Index, Partition
from bus.sensors import CameraFrame, Labels, SensorSchema
from bus.spec import NO_LATENCY, BusSpec
from bus.wire.fixed_layout import Decode, PayloadLayout
from bus.wire.frames import DriveFrame, LinkFrame, Mask, Message, SenseFrame, Values
from bus.wire.keys import check_run
from bus.wire.message_type import check_message


@final
@dataclass(frozen=True, slots=True)
class RunSchema:
    """Schema of a run: parameters that both sides must agree on.

    Args:
        run: Name of the run, second chunk of every key.
        partition: Partition of the cells into shards.
        readings: Sensors of the cells.
        message: The protocol's message type; None without messages.
        latency: Latency of the messages, in ticks.

    Raises:
        RunNameError: The name can't stand in a key.
        WireError: The message type can't go over the wire.
    """

    run: str
    partition: Partition
    readings: SensorSchema
    message: np.dtype[Any] | None
    latency: BusSpec = NO_LATENCY

    def __post_init__(self) -> None:
        check_run(self.run)
        if self.message is not None:
            object.__setattr__(self, "message", check_message(self.message))

    @property
    def lookahead(self) -> int:
        """Ticks by which the plant runs ahead of the drives."""
        return self.latency.lookahead(talks=self.message is not None)


class Senses(NamedTuple):
    """Sensor readings of n cells; the arrays are writable.

    Attributes:
        presence: ``(n, sensors)``.
        encoder_m: ``(n, 2)`` travel, None without encoders.
        level: ``(n, sensors)`` in [0, 1], None without levels.
        label: ``(n,)``, None without scanners.
        picture: Frame of a camera, the same for all; None in ticks without a frame.
    """

    presence: Mask
    encoder_m: Values | None
    level: Values | None
    label: Labels | None
    picture: CameraFrame | None


class RelayedLinks(NamedTuple):
    """Messages that the coordinator passes on, in the order of the shards' incoming links, shard after shard.

    Attributes:
        sent: ``(m,)`` uint8, 1 where a message was sent.
        message: ``(m,)``, packed as the protocol declares it; any value where none was sent.
    """

    sent: NDArray[np.uint8]
    message: NDArray[np.void]


def relayed_links(wiring: RunSchema, data: tuple[bytes, bytes]) -> RelayedLinks:
    """Decode relayed messages from a snapshot.

    Args:
        wiring: Schema of the run.
        data: The bytes of ``RelayedLinks.sent`` and ``RelayedLinks.message``.

    Raises:
        StateError: They are not of the run's links.
    """
    partition, message = wiring.partition, wiring.message
    links = sum(len(partition.incoming(shard)) for shard in range(partition.count))
    if message is None or [len(part) for part in data] != [links, links * message.itemsize]:
        raise StateError(f"relayed messages: must be of {links} links")
    return RelayedLinks(np.frombuffer(data[0], np.uint8), np.frombuffer(data[1], message))


class DriveBatch(ABC):
    """Drives of all units, decoded at once when they are all there.

    Attributes:
        sizes: Bytes of each unit's payload.
        tick_at: Place of the tick in a payload.
    """

    sizes: Sequence[int]
    tick_at: slice

    @abstractmethod
    def stamp(self, tick: int) -> bytes:
        """Return the bytes of a payload at ``tick_at``."""

    @abstractmethod
    def decode(self, payloads: Sequence[bytes]) -> list[Any] | None:
        """Return what ``join_drives`` and ``relay`` take, of all units; None where a payload is not valid.

        Args:
            payloads: One a unit, in their order, of the right size and tick.
        """


class CoordinatorCodec(ABC):
    """The plant's side of a wire format.

    Attributes:
        unit_cells: Indices of each unit's cells.
        sense_keys: Key of each unit's sense.
        drive_units, alive_units, ready_units: Unit of each such key.
        drive_expr, alive_expr, ready_expr: Expressions to subscribe to and to watch.
        blank_drives: Substitute for each unit that sends no drive.
        decode_drive: From a unit and any payload to the tick and value of its drive, or WireError.
        batch: Decoder of all units' drives at once; None: they are decoded one by one.
        relays: Whether drives bring messages, which the coordinator passes on.
    """

    unit_cells: tuple[Index, ...]
    sense_keys: tuple[str, ...]
    drive_units: dict[str, int]
    alive_units: dict[str, int]
    ready_units: dict[str, int]
    drive_expr: str
    alive_expr: str
    ready_expr: str
    blank_drives: list[Any]
    decode_drive: Decode
    batch: DriveBatch | None = None
    relays: bool = False

    @abstractmethod
    def sense_payloads(self, frame: SenseFrame, relayed: RelayedLinks | None = None) -> list[bytes]:
        """A payload a unit, in their order.

        Args:
            frame: The senses of all cells.
            relayed: Messages that are due in this tick, as ``relay`` returned them; None: nothing was sent.
        """

    @abstractmethod
    def join_drives(self, values: list[Any]) -> Values:
        """``(n, 2)`` from a value a unit, or what ``batch`` made of all; may be written."""

    def relay(self, values: list[Any], live: Mask | None) -> RelayedLinks:
        """Return the messages of a tick in the order of their receivers; only for a format that relays.

        Args:
            values: A value a unit, of its drive, or what ``batch`` made of all.
            live: ``(n,)``, cells whose messages count; None: all.
        """
        del values, live
        raise AssertionError("this format does not relay: this is a bug")


class ParticipantCodec(ABC):
    """A shard's side of a wire format.

    Attributes:
        alive_keys, ready_keys, drive_keys: The shard's own keys, one a unit.
        unit_cells: Indices (in the lattice) of each unit's cells.
        sense_units: Unit of each sense key.
        blank_senses: Substitute for each unit without a sense payload.
        decode_sense: From a unit and any payload to the tick and value of its sense, or WireError.
        in_parts: Part of each key on which the shard receives, in the order of its incoming links.
        in_sources, in_targets: Cells of the units that send and receive each part.
        blank_links: Substitute for each part that does not arrive.
        decode_link: From a part and any payload to the tick and value of its frame, or WireError.
        relays: Whether senses and drives bring the messages, which then have no parts.
        out_keys: Key of each part that the shard sends, in the order of its outgoing links.
        out_sources, out_targets: Cells of the units that send and receive each part.
    """

    alive_keys: tuple[str, ...]
    ready_keys: tuple[str, ...]
    drive_keys: tuple[str, ...]
    unit_cells: tuple[Index, ...]
    sense_units: dict[str, int]
    blank_senses: list[Any]
    decode_sense: Decode
    in_parts: dict[str, int]
    in_sources: tuple[Index, ...]
    in_targets: tuple[Index, ...]
    blank_links: list[Any]
    decode_link: Decode
    relays: bool = False
    out_keys: tuple[str, ...]
    out_sources: tuple[Index, ...]
    out_targets: tuple[Index, ...]

    def layouts(self, tick: int) -> tuple[PayloadLayout, PayloadLayout] | None:  # noqa: ARG002
        """Return the layouts of the only payload that arrives and of the only one that is sent in a tick.

        None where there are several payloads, or values without fixed positions.
        """
        return None

    @abstractmethod
    def join_senses(self, values: list[Any]) -> Senses:
        """Join the decoded senses of all units of the shard."""

    @abstractmethod
    def join_links(self, values: list[Any], sensed: list[Any]) -> tuple[Mask, Message]:
        """Mask and messages ``(m,)`` of all incoming links, messages zero where none was sent.

        Args:
            values: A value a part.
            sensed: A value a unit, of the senses that bring relayed messages.
        """

    @abstractmethod
    def drive_payloads(self, frame: DriveFrame, links: LinkFrame | None = None) -> list[bytes]:
        """A payload a unit, in their order.

        Args:
            frame: The drives of the shard's cells.
            links: The messages of the same tick, for formats that relay; None: nothing is sent.

        Raises:
            WireError: A drive is not finite.
        """

    @abstractmethod
    def link_payloads(self, frame: LinkFrame) -> list[bytes]:
        """A payload a part that the shard sends, in their order."""


def as_slice(index: Index) -> slice | Index:
    """Return a selection as a slice where it is contiguous: NumPy then copies instead of gathering."""
    if len(index) and int(index[-1]) - int(index[0]) == len(index) - 1:
        return slice(int(index[0]), int(index[-1]) + 1)
    return index
