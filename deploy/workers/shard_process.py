"""Process of one shard that was started by hand: finds the plant, joins the run, and ends with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

from bus.errors import BusError, TransportError, WaitInterrupted
from bus.wire.keys import check_run, plant_key, shard_key, shard_process_key
from deploy.errors import DeployError, InputError
from deploy.scenes.fault_schedule import permanent_crashes
from deploy.scenes.fingerprint import cells_fingerprint
from deploy.workers.connecting import QUIET_S, connect_patiently
from deploy.workers.join import JoinAnswer, JoinRefusal, decode, encode, request_of
from deploy.workers.worker import begin_shard, dead_by_schedule, serve

if TYPE_CHECKING:
    from bus.partition import Partition
    from bus.transports.zenoh import Identity, ZenohEndpoint
    from cell_firmware.agent import ShardResult
    from deploy.scenes.scene import Scene
    from deploy.util.signals import Interruption
    from deploy.workers.worker import WorkerConfig

_AGAIN_S: Final = 0.1
_ANSWER_S: Final = 2.0


class ShardLost(DeployError):
    """End of a shard whose cells the plant has dropped."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class ShardProcess:
    """Process of one shard, for a run whose plant is started elsewhere.

    Attributes:
        scene: Scene of the run; the same as the plant's.
        partition: Cells of each shard.
        shard: Number of the shard.
        run: Name of the run.
        connect: Endpoint of the plant or of a router.
        identity: Identity to present there; None: none.
        say: Called with each line for people.
    """

    scene: Scene
    partition: Partition
    shard: int
    run: str
    connect: str
    identity: Identity | None
    say: Callable[[str], None]

    def work(self, interruption: Interruption) -> ShardResult | None:
        """Join the run, and run the agents of the shard to the run's end.

        Args:
            interruption: Signals; the shard leaves the run when one comes.

        Returns:
            How the shard ended; None if the run stopped before the shard began.

        Raises:
            InputError: The plant refuses this process.
            DeployError: No plant answers in time, or the plant has dropped the cells.
            FirmwareError: The firmware can't be loaded or initialised.
            BusError: The plant left.
            Interrupted: A signal came.
        """
        with interruption.interruptible():
            facts = cells_fingerprint(self.scene)
            endpoint = connect_patiently(self.connect, self.scene.stall, self.identity, self.name, self.say)
        try:
            with interruption.interruptible():
                process = str(endpoint.session.zid())
                endpoint.declare_alive(shard_process_key(self.run, self.shard, process))
                order = self._joined(endpoint, process, facts)
                built = self._built(endpoint, order, process)
            self.say(f"{self.name}: joined run {self.run} at {self.connect}")
            interruption.wake = endpoint.wake
            try:
                result = serve(order, self.shard, endpoint, built)
            except WaitInterrupted:
                interruption.raise_if_requested()
                raise
            return self._checked(order, result)
        finally:
            interruption.wake = None
            endpoint.close()

    @property
    def name(self) -> str:
        """Name of the process in messages."""
        cells = self.partition.cells(self.shard)
        row, column = self.partition.lattice.cells[int(cells[0])]
        return f"cell {row},{column}" if len(cells) == 1 else f"shard {self.shard} of {self.partition.count}"

    def _joined(self, endpoint: ZenohEndpoint, process: str, facts: dict[str, str]) -> WorkerConfig:
        """Ask the plant for a place, until it answers.

        Raises:
            InputError: The plant refuses.
            DeployError: No plant answers in time, or another process has the place.
        """
        asked = encode(request_of(self.shard, self.partition.count, process, facts, self.scene.canonical()))
        begun, said = time.monotonic(), ""
        while True:
            problem = "the plant does not answer yet"
            payload = self._answer(endpoint, asked)
            if payload is not None:
                answer = _decoded(payload)
                if isinstance(answer, JoinAnswer):
                    return answer.config(self.scene, self.partition, self.run, self.shard)
                problem = answer.problem
                if not answer.later:
                    raise InputError(f"{self.name}: refused by the plant of run {self.run}: {problem}")
            elif others := self._other_runs(endpoint):
                problem = f"no plant of a run {self.run}; there are: {', '.join(others)} (--run)"
            waited_s = time.monotonic() - begun
            if waited_s >= self.scene.stall.start_s:
                raise DeployError(
                    f"{self.name}: run {self.run} at {self.connect}: {problem}; waited "
                    f"{self.scene.stall.start_s:g} s (stall.start_s)"
                )
            if problem != said and waited_s > QUIET_S:
                said = problem
                self.say(f"{self.name}: waits for run {self.run} at {self.connect}: {problem}")
            time.sleep(_AGAIN_S)

    def _answer(self, endpoint: ZenohEndpoint, asked: bytes) -> bytes | None:
        """Return the plant's answer; None if no plant answers."""
        from bus.transports.zenoh.requests import send_request

        try:
            return send_request(endpoint, shard_key(self.run, self.shard, "join"), asked, _ANSWER_S)
        except TransportError:
            return None

    def _other_runs(self, endpoint: ZenohEndpoint) -> list[str]:
        """Return the names of the runs whose plants are there."""
        from bus.transports.zenoh.requests import tokens_at

        names = {key.split("/")[1] for key in tokens_at(endpoint, plant_key("*", "alive"), _ANSWER_S)}
        return sorted(names - {self.run})

    def _built(self, endpoint: ZenohEndpoint, order: WorkerConfig, process: str) -> Any:
        """Build the shard; tell the plant if that fails."""
        from cell_firmware.errors import FirmwareError, FirmwareFailed

        try:
            return begin_shard(order, self.shard)
        except (FirmwareError, FirmwareFailed) as error:
            lines = str(error).splitlines()
            why = lines[0] if lines else "its program failed"
            failed = request_of(self.shard, self.partition.count, process, {}, failed=why)
            self._answer(endpoint, encode(failed))
            raise

    def _checked(self, order: WorkerConfig, result: ShardResult | None) -> ShardResult | None:
        """Return the result of a shard that ended with the run, or by the scene's schedule.

        Raises:
            ShardLost: The plant has dropped the cells.
        """
        if result is None or result.stopped:
            return result
        first = 0 if order.resumed is None else order.resumed.tick
        if dead_by_schedule(order, self.shard, permanent_crashes(self.scene), first + result.ticks):
            return result
        if result.failures:
            raise DeployError("\n".join(str(failure) for failure in result.failures[:1]))
        raise ShardLost(f"{self.name}: the plant has dropped its cells: it was silent or late for too long")


def _decoded(payload: bytes) -> JoinAnswer | JoinRefusal:
    """The plant's answer.

    Raises:
        DeployError: The payload is none.
    """
    try:
        return decode(JoinRefusal, payload)
    except DeployError:
        pass
    try:
        return decode(JoinAnswer, payload)
    except DeployError as error:
        raise DeployError(f"the plant's answer can't be read, is it of another version? {error}") from None


def check_name(run: str) -> str:
    """Return a valid name of a run.

    Raises:
        InputError: The name can't be part of a key.
    """
    try:
        return check_run(run)
    except BusError as error:
        raise InputError(f"--run: {error}") from None
