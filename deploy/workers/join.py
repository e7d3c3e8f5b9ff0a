"""Joining a run by hand: the request of a process of cells, and the plant's answer.

A process that was started by hand knows its scene and its shard. The plant tells the rest, once both sides agree on
everything that determines the bits of the run. Both messages are MessagePack, checked field by field.
"""

from __future__ import annotations

import os
import platform
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar, cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
from pydantic import Field, ValidationError

from bus.lockstep.registers import RegisterRequest
from bus.sensors import SensorSchema
from bus.spec import Spec
from bus.wire.keys import WireFormat
from bus.wire.msgpack_codec import VERSION
from deploy.errors import DeployError
from deploy.workers.worker import ResumePoint, WorkerConfig

if TYPE_CHECKING:
    from bus.partition import Partition
    from deploy.scenes.scene import Scene

_Count = Annotated[int, Field(ge=0)]
_SCENE_LIMIT: Final = 32_768
"""Longest scene that a request brings, bytes."""
_Text = Annotated[str, Field(max_length=4096)]


class JoinRequest(Spec):
    """Request of a process of cells to take a shard's place.

    Attributes:
        v: Version of every payload.
        shard: Number of the shard.
        shards: Number of shards that the process expects.
        process: Name of the process, as in its token.
        host: Name of its host.
        pid: Process id there.
        facts: What determines the bits of its cells, by name.
        scene: Its scene, as hashed in ``facts``, so that differences can be named; empty: it is too long.
        failed: Why the process ends before its cells are ready; empty: it asks to take the shard's place.
    """

    v: Literal[2] = VERSION
    shard: _Count
    shards: _Count
    process: Annotated[str, Field(pattern=r"[0-9a-f]{1,64}")]
    host: _Text
    pid: _Count
    facts: Annotated[dict[_Text, _Text], Field(max_length=64)]
    scene: Annotated[bytes, Field(max_length=_SCENE_LIMIT)] = b""
    failed: _Text = ""

    @property
    def whose(self) -> str:
        """Describe the process: ``shard 2 (host b, process 4711)``."""
        return f"shard {self.shard} (host {_printable(self.host)}, process {self.pid})"


class ResumedShard(Spec):
    """Resume point of a shard.

    Attributes:
        tick: First tick to run.
        dead: Indices of the cells that were dead before this tick.
        state: State of the shard's cells; None: all of them are dead.
        links: Messages that were on their way to the shard.
    """

    tick: _Count
    dead: tuple[_Count, ...]
    state: bytes | None
    links: tuple[tuple[bytes, bytes], ...]


class JoinAnswer(Spec):
    """The plant's answer: the configuration of a shard's process, as far as its scene doesn't say it.

    Attributes:
        v: Version of every payload.
        wire: Wire format.
        sensors: Schema of the cells' sensors.
        registers: Registers that the cells publish: period in ticks and names, or None for all.
        metered: See ``WorkerConfig``, as all of the following.
    """

    v: Literal[2] = VERSION
    wire: WireFormat
    sensors: tuple[_Count, bool, bool, _Count, _Count]
    registers: tuple[tuple[Annotated[int, Field(ge=1)], tuple[_Text, ...] | None], ...]
    metered: bool
    byte_accurate_links: bool
    joins_running: bool
    snapshots: bool
    messages: bool
    traced: bool
    resumed: ResumedShard | None

    @classmethod
    def of(cls, order: WorkerConfig, shard: int, *, joins_running: bool) -> JoinAnswer:
        """Return the answer for a shard of a run whose workers have this configuration."""
        point, schema = order.resumed, order.sensors
        resumed = None
        if point is not None and not joins_running:
            resumed = ResumedShard(
                tick=point.tick,
                dead=point.dead,
                state=point.states.get(shard),
                links=tuple(point.links.get(shard, ())),
            )
        return cls(
            wire=order.wire,
            sensors=(schema.sensors, schema.encoders, schema.levels, schema.labels, schema.camera),
            registers=tuple(
                (one.every, None if one.names is None else tuple(sorted(one.names)))
                for one in order.register_requests
            ),
            metered=order.metered,
            byte_accurate_links=order.byte_accurate_links,
            joins_running=joins_running,
            snapshots=order.snapshots,
            messages=order.messages,
            traced=order.traced,
            resumed=resumed,
        )

    def config(self, scene: Scene, partition: Partition, run: str, shard: int) -> WorkerConfig:
        """Return the configuration of a shard's process."""
        from plant.array import CellArray

        resumed = None
        if self.resumed is not None:
            state = self.resumed.state
            states = {} if state is None else {shard: state}
            resumed = ResumePoint(
                self.resumed.tick, self.resumed.dead, states, {shard: self.resumed.links}, relayed={}
            )
        return WorkerConfig(
            scene=scene,
            array=CellArray(scene.array),
            partition=partition,
            wire=self.wire,
            run=run,
            connect="",
            sensors=SensorSchema(*self.sensors),
            register_requests=tuple(
                RegisterRequest(every, None if names is None else frozenset(names))
                for every, names in self.registers
            ),
            metered=self.metered,
            byte_accurate_links=self.byte_accurate_links,
            joins_running=self.joins_running,
            keys=(),
            own_process=True,
            snapshots=self.snapshots,
            messages=self.messages,
            traced=self.traced,
            resumed=resumed,
            killed=False,  # whoever started it would take a kill for a failure
        )


class JoinRefusal(Spec):
    """The plant's refusal.

    Attributes:
        v: Version of every payload.
        problem: Why, in one line.
        later: Whether the same request may be granted later.
    """

    v: Literal[2] = VERSION
    problem: _Text
    later: bool = False


_Any = TypeVar("_Any", JoinRequest, JoinAnswer, JoinRefusal)


def encode(message: JoinRequest | JoinAnswer | JoinRefusal) -> bytes:
    """The payload of a message."""
    return cast("bytes", cast("Any", msgpack).packb(message.model_dump()))


def decode(kind: type[_Any], payload: bytes | None) -> _Any:
    """A message of a kind.

    Raises:
        DeployError: The payload is none, or of another version; the message names the first field that is wrong.
    """
    try:
        found: Any = cast("Any", msgpack).unpackb(payload or b"", use_list=False, strict_map_key=True)
        return kind.model_validate(found, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "it"
        raise DeployError(f"{place}: {first['msg']}") from None
    except (ValueError, TypeError, OverflowError, msgpack.UnpackException) as error:
        raise DeployError(f"no MessagePack: {type(error).__name__}") from None


def request_of(
    shard: int, shards: int, process: str, facts: dict[str, str], scene: bytes = b"", failed: str = ""
) -> JoinRequest:
    """Return this process's request; see ``JoinRequest``."""
    return JoinRequest(
        shard=shard,
        shards=shards,
        process=process,
        host=platform.node()[:64],
        pid=os.getpid(),
        facts=facts,
        scene=scene if len(scene) <= _SCENE_LIMIT else b"",
        failed=failed[:1024],
    )


def _printable(text: str) -> str:
    """Return a text from the network as it can be shown on a terminal."""
    return "".join(char if char.isprintable() else "?" for char in text)
