"""The lockstep: ``Coordinator`` on the plant's side, ``Participant`` for each shard of cells.

At tick k the coordinator publishes the senses. Each shard waits for the senses and for the messages that its
neighbours sent in tick k - 1, computes, and sends messages and drives. The coordinator waits for the drives. Every
payload carries its tick: an early payload is stored, a late one is counted. No side waits for dead cells.
"""

from __future__ import annotations

from bus.lockstep.coordinator import Coordinator
from bus.lockstep.counters import Loss, MessageCounters, Reason
from bus.lockstep.participant import Participant
from bus.lockstep.shard_io import TickInputs
from bus.wire.formats import WireFormat

__all__ = ["Coordinator", "Loss", "MessageCounters", "Participant", "Reason", "TickInputs", "WireFormat"]
