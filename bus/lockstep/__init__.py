"""The lockstep: ``Coordinator`` on the plant's side, ``Participant`` for each shard of cells.

At tick k the host publishes the senses; each shard waits for them and for what its neighbours' cells sent
in tick k - 1, computes, sends messages and drives; the host waits for the drives. Every payload carries its
tick: one that comes early is kept, one that comes late is counted. Who is gone is waited for by nobody.
"""

from __future__ import annotations

from bus.lockstep.coordinator import Coordinator
from bus.lockstep.counters import Loss, MessageCounters, Reason
from bus.lockstep.participant import Participant
from bus.lockstep.shard_io import TickInputs
from bus.wire.formats import WireFormat

__all__ = ["Coordinator", "Loss", "MessageCounters", "Participant", "Reason", "TickInputs", "WireFormat"]
