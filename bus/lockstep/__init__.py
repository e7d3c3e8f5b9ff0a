"""The lockstep: ``Host`` on the plant's side, ``Member`` for each shard of cells.

At tick k the host publishes the senses; each shard waits for them and for what its neighbours' cells sent
in tick k - 1, computes, sends messages and drives; the host waits for the drives. Every payload carries its
tick: one that comes early is kept, one that comes late is counted. Who is gone is waited for by nobody.
"""

from __future__ import annotations

from bus.lockstep.coordinator import Host
from bus.lockstep.counters import Counts, Loss, Reason
from bus.lockstep.participant import Member
from bus.lockstep.shard_io import Gathered
from bus.wire.formats import FormName

__all__ = ["Counts", "FormName", "Gathered", "Host", "Loss", "Member", "Reason"]
