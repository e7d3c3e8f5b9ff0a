"""Keys of wire formats whose units are shards: ``packed`` and ``relayed``."""

from __future__ import annotations

from bus.wire.format import CoordinatorCodec, ParticipantCodec, RunSchema
from bus.wire.keys import shard_key


class PerShardCoordinator(CoordinatorCodec):
    """The plant's side, with a unit a shard: its units and keys.

    Args:
        wiring: Schema of the run.
    """

    def __init__(self, wiring: RunSchema) -> None:
        partition, run = wiring.partition, wiring.run
        shards = range(partition.count)
        self.unit_cells = tuple(partition.cells(s) for s in shards)
        self.sense_keys = tuple(shard_key(run, s, "sense") for s in shards)
        self.drive_units = {shard_key(run, s, "drive"): s for s in shards}
        self.alive_units = {shard_key(run, s, "alive"): s for s in shards}
        self.ready_units = {shard_key(run, s, "ready"): s for s in shards}
        self.drive_expr = shard_key(run, None, "drive")
        self.alive_expr = shard_key(run, None, "alive")
        self.ready_expr = shard_key(run, None, "ready")


class PerShardParticipant(ParticipantCodec):
    """A shard's side, with a single unit: its cells and keys but those of links.

    Args:
        wiring: Schema of the run.
        shard: Index of the shard.
    """

    def __init__(self, wiring: RunSchema, shard: int) -> None:
        run = wiring.run
        self.alive_keys = (shard_key(run, shard, "alive"),)
        self.ready_keys = (shard_key(run, shard, "ready"),)
        self.drive_keys = (shard_key(run, shard, "drive"),)
        self.unit_cells = (wiring.partition.cells(shard),)
        self.sense_units = {shard_key(run, shard, "sense"): 0}
