"""The packed form: one little-endian array a shard, and one a border between shards."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np

from bus import wire
from bus.forms.form import HostForm, MemberForm, Wiring, stretch
from bus.keys import shard_key, shard_link_key

_SENSE: Final = wire.layout("presence", "encoder_m")
_DRIVE: Final = wire.layout("drive")
_LINK: Final = wire.layout("sent", "message")


@final
class PackedHost(HostForm):
    """The plant's side: a unit is a shard."""

    def __init__(self, wiring: Wiring) -> None:
        partition, run = wiring.partition, wiring.run
        shards = range(partition.count)
        self._cells = len(partition.lattice)
        self.unit_cells = tuple(partition.cells(s) for s in shards)
        self._rows = tuple(stretch(cells) for cells in self.unit_cells)
        self.sense_keys = tuple(shard_key(run, s, "sense") for s in shards)
        self.drive_units = {shard_key(run, s, "drive"): s for s in shards}
        self.alive_units = {shard_key(run, s, "alive"): s for s in shards}
        self.ready_units = {shard_key(run, s, "ready"): s for s in shards}
        self.drive_expr = shard_key(run, None, "drive")
        self.alive_expr = shard_key(run, None, "alive")
        self.ready_expr = shard_key(run, None, "ready")
        self.blank_drives = [0.0] * partition.count

    def sense_payloads(self, frame: wire.SenseFrame) -> list[bytes]:
        """A payload a shard."""
        encoder_m = frame.encoder_m
        return [
            wire.pack(
                frame.tick,
                {
                    "presence": wire.bits_bytes(frame.presence[rows]),
                    "encoder_m": None if encoder_m is None else encoder_m[rows].tobytes(),
                },
            )
            for rows in self._rows
        ]

    def decode_drive(self, unit: int, payload: bytes) -> tuple[int, Any]:
        """Tick and ``(cells, 2)`` drives of a shard."""
        rows = len(self.unit_cells[unit])
        tick, fields = wire.unpack("drive", payload, rows * 16, _DRIVE)
        return tick, wire.floats("drive", fields["drive"], rows)

    def join_drives(self, values: list[Any]) -> wire.Values:
        """``(n, 2)`` from an array a shard."""
        drives = np.empty((self._cells, 2))
        for rows, value in zip(self._rows, values, strict=True):
            drives[rows] = value
        return drives


@final
class PackedMember(MemberForm):
    """A shard's side: one unit, a part a border."""

    def __init__(self, wiring: Wiring, shard: int) -> None:
        partition, run = wiring.partition, wiring.run
        cells = partition.cells(shard)
        self._rows = len(cells)
        self._sensors = wiring.sensors
        self._encoders = wiring.encoders
        self.alive_keys = (shard_key(run, shard, "alive"),)
        self.ready_keys = (shard_key(run, shard, "ready"),)
        self.drive_keys = (shard_key(run, shard, "drive"),)
        self.unit_cells = (cells,)
        self.sense_units = {shard_key(run, shard, "sense"): 0}
        presence = np.zeros((self._rows, self._sensors), dtype=np.bool_)
        self.blank_senses = [(presence, np.zeros((self._rows, 2)) if wiring.encoders else None)]
        self._message = np.dtype([]) if wiring.message is None else wiring.message
        self._zero = np.zeros((), dtype=self._message)
        incoming = () if wiring.message is None else partition.incoming_borders(shard)
        outgoing = () if wiring.message is None else partition.outgoing_borders(shard)
        self._in_counts = tuple(b.stop - b.start for b in incoming)
        self.in_parts = {shard_link_key(run, b.shard, shard): i for i, b in enumerate(incoming)}
        self.in_sources = tuple(partition.cells(b.shard) for b in incoming)
        self.in_targets = tuple(cells for _ in incoming)
        self.blank_links = [
            (np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=self._message))
            for count in self._in_counts
        ]
        self._out_links = tuple(slice(b.start, b.stop) for b in outgoing)
        self.out_keys = tuple(shard_link_key(run, shard, b.shard) for b in outgoing)
        self.out_sources = tuple(cells for _ in outgoing)
        self.out_targets = tuple(partition.cells(b.shard) for b in outgoing)

    def decode_sense(self, unit: int, payload: bytes) -> tuple[int, Any]:  # noqa: ARG002 - one unit only
        """Tick, and ``(n, sensors)`` presence with ``(n, 2)`` encoder travel or None."""
        count = self._rows * self._sensors
        tick, fields = wire.unpack("sense", payload, count // 8 + self._rows * 16, _SENSE)
        presence = wire.bits("sense", fields["presence"], count).reshape(self._rows, self._sensors)
        if self._encoders:
            return tick, (presence, wire.floats("sense", fields["encoder_m"], self._rows))
        wire.nothing("sense", "encoder_m", fields["encoder_m"])
        return tick, (presence, None)

    def join_senses(self, values: list[Any]) -> tuple[wire.Mask, wire.Values | None]:
        """Those of the one unit."""
        presence, encoder_m = values[0]
        return presence.copy(), None if encoder_m is None else encoder_m.copy()

    def decode_link(self, part: int, payload: bytes) -> tuple[int, Any]:
        """Tick, and ``(m,)`` mask with ``(m,)`` messages, zero where none was sent."""
        count = self._in_counts[part]
        tick, fields = wire.unpack("link", payload, count // 8 + count * self._message.itemsize, _LINK)
        sent = wire.bits("link", fields["sent"], count)
        message = wire.messages("link", fields["message"], count, self._message)
        if not sent.all():
            message[~sent] = self._zero
        return tick, (sent, message)

    def join_links(self, values: list[Any]) -> tuple[wire.Mask, wire.Message]:
        """The borders' stretches in their order."""
        if not values:
            return np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=self._message)
        return np.concatenate([sent for sent, _ in values]), np.concatenate(
            [message for _, message in values]
        )

    def drive_payloads(self, frame: wire.DriveFrame) -> list[bytes]:
        """One payload."""
        return [wire.pack(frame.tick, {"drive": frame.drive.tobytes()})]

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a border."""
        return [
            wire.pack(
                frame.tick,
                {"sent": wire.bits_bytes(frame.sent[links]), "message": frame.message[links].tobytes()},
            )
            for links in self._out_links
        ]
