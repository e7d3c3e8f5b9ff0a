"""What the tests of the bus share: transports, a clock that obeys, and small arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.lockstep import Coordinator, Loss, Participant, TickInputs
from bus.lockstep.registers import RegisterRequest
from bus.partition import Partition
from bus.sensors import CameraFrame, SensorSchema
from bus.spec import NO_LATENCY, BusSpec, StallSpec
from bus.transports.base import Endpoint, Event, LivelinessChange, Publisher, Received, Urgency
from bus.transports.memory import MemoryBus
from bus.transports.zenoh import open_client, open_hub
from bus.wire.formats import WireFormat
from bus.wire.frames import Control, DriveFrame, LinkFrame, SenseFrame

MESSAGE = np.dtype([("u", "<f8"), ("hops", "<u2")])
SENSORS = 2
FORMS: list[WireFormat] = ["packed", "per_cell", "relayed"]
every_format = pytest.mark.parametrize("form", FORMS)


class Network:
    """Endpoints of one transport: the first is the plant's, the others are cells'."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._bus = MemoryBus()
        self._endpoints: list[Endpoint] = []
        self.locator = ""

    def endpoint(self) -> Endpoint:
        endpoint: Endpoint
        if self.name == "memory":
            endpoint = self._bus.endpoint()
        elif not self._endpoints:
            hub = open_hub()
            self.locator = hub.locator
            endpoint = hub
        else:
            endpoint = open_client(self.locator)
            if self.name == "zenoh, direct":
                whole = endpoint.subscribe
                endpoint.subscribe = lambda key, haste="wake", *, direct=False: whole(
                    key, haste, direct="*" not in key
                )
        self._endpoints.append(endpoint)
        return endpoint

    def close(self) -> None:
        for endpoint in reversed(self._endpoints):
            endpoint.close()


class FakeClock:
    """Wall time that passes only where somebody waits for it."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class ClockedEndpoint(Endpoint):
    """An endpoint whose waits take no time: when nothing is there, the clock jumps to their end."""

    def __init__(self, inner: Endpoint, clock: FakeClock) -> None:
        super().__init__()
        self._inner = inner
        self._clock = clock

    def receive_all(
        self, timeout_s: float | None, enough: int = 1, quiet_key: str | None = None
    ) -> list[Event]:
        rest, self._rest = self._rest, []
        events = rest + self._inner.receive_all(0)
        if not events:
            assert timeout_s is not None, "waits for ever for what never comes"
            self._clock.now += timeout_s
        return events

    def publisher(self, key: str) -> Publisher:
        return self._inner.publisher(key)

    def put_all(self, puts: Iterable[tuple[Publisher, bytes]]) -> None:
        self._inner.put_all(puts)

    def subscribe(self, key_expr: str, haste: Urgency = "wake", *, direct: bool = False) -> None:
        self._inner.subscribe(key_expr, haste, direct=direct)

    def declare_alive(self, key: str) -> None:
        self._inner.declare_alive(key)

    def withdraw(self, key: str) -> None:
        self._inner.withdraw(key)

    def watch_alive(self, key_expr: str) -> None:
        self._inner.watch_alive(key_expr)

    def wake(self) -> None:
        self._inner.wake()

    def close(self) -> None:
        self._inner.close()


PRESENCE = SensorSchema(SENSORS)
EVERYTHING = SensorSchema(SENSORS, encoders=True, levels=True, labels=4, camera=3)


@dataclass
class System:
    """A host and its members on one network, all in this thread once they have started."""

    network: Network
    partition: Partition
    form: WireFormat
    message: np.dtype[Any] | None = None
    readings: SensorSchema = PRESENCE
    stall: StallSpec = field(default_factory=StallSpec)
    clock: FakeClock | None = None
    wanted: Sequence[RegisterRequest] = ()
    latency: BusSpec = NO_LATENCY
    keeps: bool = False
    direct: bool = False

    def __post_init__(self) -> None:
        self.endpoint = self._clocked(self.network.endpoint())
        self.host = Coordinator(self.endpoint, self.partition, self.form, **self._agreed())
        self.member_endpoints = [self._clocked(self.network.endpoint()) for _ in range(self.partition.count)]
        self.members = [
            Participant(
                endpoint,
                self.partition,
                shard,
                self.form,
                cell_counters=self._cell_counters(shard),
                direct=self.direct,
                **self._agreed(),
            )
            for shard, endpoint in enumerate(self.member_endpoints)
        ]

    def _clocked(self, endpoint: Endpoint) -> Endpoint:
        return endpoint if self.clock is None else ClockedEndpoint(endpoint, self.clock)

    def _agreed(self) -> dict[str, Any]:
        agreed: dict[str, Any] = {
            "run": "test",
            "readings": self.readings,
            "message": self.message,
            "stall": self.stall,
            "wanted": self.wanted,
            "latency": self.latency,
            "keeps": self.keeps,
        }
        if self.clock is not None:
            agreed["clock"] = self.clock
        return agreed

    def _cell_counters(self, shard: int) -> Callable[[], dict[str, int]]:
        return lambda: {"shards": 1, "numbers": shard, "nothing": 0}

    def start(self) -> System:
        # Everybody subscribed as it was made, so that each is ready without waiting for the next.
        for member in self.members:
            member.ready(10.0)
        self.host.barrier(10.0)
        return self

    def sense(self, tick: int) -> SenseFrame:
        """A frame whose every value encodes its tick and cell."""
        n = len(self.partition.lattice)
        bits = (np.arange(n * SENSORS).reshape(n, SENSORS) * 7 + tick) % 3 == 0
        travel = (tick + np.arange(n * 2).reshape(n, 2) / 3.0) if self.readings.encoders else None
        level = (np.arange(n * SENSORS).reshape(n, SENSORS) + tick) / (n * SENSORS + 99.0)
        label = (np.arange(n) + tick) % (self.readings.labels + 1) if self.readings.labels else None
        return SenseFrame(
            tick, bits, travel, level if self.readings.levels else None, label, self._picture(tick)
        )

    def _picture(self, tick: int) -> CameraFrame | None:
        """In every third tick where there is a camera: of all parcels but one."""
        if not self.readings.camera or tick % 3:
            return None
        parcel = np.flatnonzero(np.arange(self.readings.camera) != tick % self.readings.camera)
        return CameraFrame(parcel, np.stack([parcel / 3.0, tick - parcel, -parcel / 7.0], axis=1))

    def drive(self, shard: int, tick: int) -> DriveFrame:
        cells = self.partition.cells(shard)
        return DriveFrame(tick, np.stack([cells + tick / 7.0, -1.0 / (cells + tick + 1.0)], axis=1))

    def links(self, shard: int, tick: int) -> LinkFrame | None:
        """A message that encodes its link, over two links of three."""
        if self.message is None:
            return None
        out = self.partition.outgoing(shard)
        message = np.zeros(len(out), dtype=self.message)
        message["u"] = (out.source * 4 + out.source_side) / 3.0 + tick
        message["hops"] = out.source + tick
        return LinkFrame(tick, (out.source + out.source_side + tick) % 3 != 0, message)


def grid(rows: int, columns: int) -> Lattice:
    """A full rectangle of cells."""
    return Lattice((r, c) for r in range(rows) for c in range(columns))


def drain(endpoint: Endpoint, until: Callable[[list[Event]], bool], timeout_s: float = 5.0) -> list[Event]:
    """Events up to the one that satisfies ``until``; fails after ``timeout_s`` of silence."""
    events: list[Event] = []
    while not until(events):
        event = endpoint.receive(timeout_s)
        assert event is not None, f"nothing came after {events[-3:]}"
        events.append(event)
    return events


def payloads(events: list[Event]) -> list[bytes]:
    return [event.payload for event in events if isinstance(event, Received)]


def tokens(events: list[Event]) -> list[tuple[str, bool]]:
    return [(event.key, event.present) for event in events if isinstance(event, LivelinessChange)]


def settle(publisher: Publisher, endpoint: Endpoint) -> None:
    """Waits until ``publisher`` is matched; events that ``endpoint`` gets meanwhile would be lost, so none may come."""
    while not publisher.matched():
        assert endpoint.receive(0.005) is None


def gathered(result: TickInputs | Control) -> TickInputs:
    assert isinstance(result, TickInputs), result
    return result


def step(system: System, tick: int, shards: list[int] | None = None) -> tuple[DriveFrame, list[Loss]]:
    """One tick in one thread: senses, every shard, drives."""
    system.host.publish(system.sense(tick))
    for shard in range(len(system.members)) if shards is None else shards:
        member = system.members[shard]
        gathered(member.gather(tick))
        member.publish(system.drive(shard, tick), system.links(shard, tick))
    return system.host.gather(tick)


def expected_drive(system: System, tick: int) -> Any:
    whole = np.zeros((len(system.partition.lattice), 2))
    for shard in range(system.partition.count):
        whole[system.partition.cells(shard)] = system.drive(shard, tick).drive
    return whole
