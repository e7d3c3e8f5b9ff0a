"""Group of workers that others start: by hand on this host or another, or by an orchestrator."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, final

from bus.errors import BarrierError, BusError
from bus.wire.keys import shard_key
from deploy.errors import DeployError
from deploy.scenes.fingerprint import cells_fingerprint, differences, scene_differences
from deploy.workers.join import JoinAnswer, JoinRefusal, JoinRequest, decode, encode

if TYPE_CHECKING:
    from bus.transports.zenoh import ZenohEndpoint
    from bus.transports.zenoh.requests import IncomingRequest, RequestQueue, Responder
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan
    from deploy.workers.presence import Presence
    from deploy.workers.worker import WorkerConfig

_REPORT_S: Final = 5.0
"""Interval at which missing shards are named while the plant waits for them, wall seconds."""
_NAMED: Final = 12
"""Shards that a line names."""
_NOTES: Final = 64
"""Most refused processes that are remembered."""


@final
class ExternalWorkers:
    """Group of processes that join the run by themselves, one for each shard.

    A process joins if everything that determines the bits of its cells is equal to the plant's. Tokens decide who is
    there: a process that knows the keys of the wire format alone, such as a cell of another program, needs no request.

    Args:
        plan: Plan of the run.
        scene: Scene of the run.
        endpoint: Endpoint of the plant that cells connect to.
        presence: Tokens of the run.
        warn: Called with one line for whatever people should see at once.
    """

    def __init__(
        self,
        plan: Plan,
        scene: Scene,
        endpoint: ZenohEndpoint,
        presence: Presence,
        warn: Callable[[str], None],
    ) -> None:
        self._plan = plan
        self._facts = cells_fingerprint(scene)
        self._scene = scene.canonical()
        self._endpoint = endpoint
        self._presence = presence
        self._warn = warn
        self._order: WorkerConfig | None = None
        self._responder: Responder | None = None
        self._lock = threading.Lock()
        self._holders: dict[int, JoinRequest] = {}
        """Processes that took a shard's place last."""
        self._refused: dict[int, tuple[str, str]] = {}
        """Process that was refused last, and why, by shard."""
        self._begun = False
        self._replaceable: set[int] = set()
        self._reported_s = 0.0

    def start(self, order: WorkerConfig) -> None:
        """Answer processes that want to join."""
        from bus.transports.zenoh.requests import RequestQueue, Responder

        self._order, self._reported_s = order, time.monotonic()
        queue: RequestQueue = RequestQueue(shard_key(self._plan.run, None, "join"), self._endpoint)
        self._responder = Responder({queue: self._answer})

    def begin(self) -> None:
        """Note that all shards are ready: from now on only replaced shards are admitted."""
        with self._lock:
            self._begun = True

    def restart(self, order: WorkerConfig, shard: int) -> None:
        """Let another process take a shard's place."""
        with self._lock:
            self._order = order
            self._replaceable.add(shard)

    def ended(self, shard: int) -> bool:
        """Whether the process that was to replace a shard has gone again."""
        with self._lock:
            holder = self._holders.get(shard)
            return (
                shard not in self._replaceable
                and holder is not None
                and not self._presence.process_is_there(shard, holder.process)
            )

    def holder(self, shard: int) -> JoinRequest | None:
        """Return the request of the process that took a shard's place last; None if nobody asked."""
        with self._lock:
            return self._holders.get(shard)

    def trouble(self, timeout_s: float) -> bool:
        """Wait, name missing shards now and then, and return False: after a refused process the right one may come."""
        time.sleep(timeout_s)
        if not self._begun and time.monotonic() - self._reported_s > _REPORT_S:
            self._reported_s = time.monotonic()
            if self._missing():
                self._warn(f"waiting for {self.awaited()}")
        return False

    def awaited(self) -> str:
        """Describe the processes that are not here: ``1 of 2 shards: 1``, or ``1 of 18 cells: 0,3``."""
        missing = self._missing()
        if not missing:
            return "processes that are here and not ready"
        if self._plan.setting != "each":
            return f"{len(missing)} of {self._plan.partition.count} shards: {_named(missing)}"
        cells = [self._plan.partition.lattice.cells[shard] for shard in missing]
        names = _named([f"{row},{column}" for row, column in cells], " ")
        return f"{len(missing)} of {self._plan.partition.count} cells: {names}"

    def programs_failed(self) -> bool:
        """Return False: processes report to their own terminal."""
        return False

    def check(self) -> None:
        """Do nothing; the barrier reports missing shards."""

    def explained(self, error: BusError) -> BusError:
        """Return the error of the barrier, with the missing shards, the refused processes and the reasons."""
        if not isinstance(error, BarrierError):
            return error
        with self._lock:
            refused = [why for _, why in self._refused.values()]
        missing, text = self._missing(), str(error)
        if missing and self._plan.setting != "each":  # else a shard is a cell, which has been named
            text += f"; missing shards: {_named(missing)}"
        if refused:
            text += f"; refused: {'; '.join(refused[:_NAMED])}"
        return BarrierError(text, absent=error.absent, unready=error.unready)

    def _missing(self) -> list[int]:
        """Return the shards that are not here."""
        return sorted(set(range(self._plan.partition.count)) - self._presence.shards("alive"))

    def details(self) -> str:
        """Return an empty string: tracebacks are on the processes' own terminals."""
        return ""

    def close(self, grace_s: float) -> None:
        """Answer no more; processes end with the run by themselves."""
        del grace_s
        if self._responder is not None:
            self._responder.close()
            self._responder = None

    # --- in the responder's thread ----------------------------------------------------------------

    def _answer(self, request: IncomingRequest) -> bytes:
        try:
            asked = decode(JoinRequest, request.payload)
        except DeployError as error:
            return encode(JoinRefusal(problem=f"the plant can't read the request: {error}"))
        with self._lock:
            return encode(self._decide(asked, request.key))

    def _decide(self, asked: JoinRequest, key: str) -> JoinAnswer | JoinRefusal:
        order, count, shard = self._order, self._plan.partition.count, asked.shard
        assert order is not None, "this is a bug: a request before the start"
        if asked.shards != count or shard >= count or key != shard_key(self._plan.run, shard, "join"):
            each = self._plan.setting == "each"
            right = "--cell ROW,COLUMN" if each else f"--shard 0/{count} to {count - 1}/{count}"
            return self._refuse(asked, f"the plant has {count} shards, not {asked.shards}: {right}")
        if asked.failed:
            return self._refuse(asked, asked.failed)
        if found := differences(self._facts, asked.facts):
            if values := scene_differences(self._scene, asked.scene):
                found = [*(one for one in found if not one.startswith("the scene ")), *values]
            return self._refuse(asked, f"differs from the plant: {'; '.join(found)}")
        if problem := self._occupied(asked):
            return JoinRefusal(problem=problem, later=True)
        if self._begun and shard not in self._replaceable:
            return JoinRefusal(
                problem="the run has begun without it, and lost shards come back with mdms plant --respawn N alone",
                later=True,
            )
        self._replaceable.discard(shard)
        self._holders[shard] = asked
        self._refused.pop(shard, None)
        return JoinAnswer.of(order, shard, joins_running=self._begun)

    def _occupied(self, asked: JoinRequest) -> str:
        """Say who has the place of a shard; empty if it is free."""
        shard = asked.shard
        holder = self._holders.get(shard)
        if (
            holder is not None
            and holder.process != asked.process
            and self._presence.process_is_there(shard, holder.process)
        ):
            return f"taken already: {holder.whose}"
        if self._presence.any_alive(shard):
            return f"shard {shard} is there already"
        return ""

    def _refuse(self, asked: JoinRequest, why: str) -> JoinRefusal:
        """Refuse a process, and say so once."""
        before, text = self._refused.get(asked.shard), f"{asked.whose}: {why}"
        if before != (asked.process, text) and (before or len(self._refused) < _NOTES):
            self._refused[asked.shard] = (asked.process, text)
            self._warn(text)
        return JoinRefusal(problem=why)


def _named(missing: Sequence[int | str], between: str = ", ") -> str:
    more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
    return f"{between.join(map(str, missing[:_NAMED]))}{more}"
