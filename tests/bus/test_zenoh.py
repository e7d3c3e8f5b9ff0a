"""What is particular to the Zenoh transport: ports, processes, forks, signals."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgpack
import pytest
import zenoh

from bus.errors import TransportError
from bus.lockstep import Loss
from bus.partition import Partition
from bus.spec import StallSpec
from bus.transports.base import Event, LivelinessChange, Received
from bus.transports.zenoh import (
    AccessPolicy,
    Identity,
    Password,
    client_config,
    hub_config,
    open_client,
    open_hub,
    open_outside,
)
from bus.transports.zenoh.endpoint import ZenohEndpoint, free_port
from bus.transports.zenoh.linger import LingerReset, tcp_ports
from bus.transports.zenoh.receive import Channel
from tests.bus.support import Network, System, drain, grid, payloads, settle, tokens

ROOT = str(Path(__file__).resolve().parents[2])
_STUCK = """
import os, sys
sys.path.insert(0, sys.argv[1])
import zenoh
from tests.system.listener import plain_client
session = plain_client(sys.argv[2])
sample = session.declare_subscriber("t/**", zenoh.handlers.FifoChannel(1))
tokens = session.liveliness().declare_subscriber("t/**", zenoh.handlers.FifoChannel(1))
sample.recv()
sys.stdin.read()
os._exit(0)
"""
_CELL = """
import sys, time
sys.path.insert(0, sys.argv[1])
from bus.transports.zenoh import open_client
endpoint = open_client(sys.argv[2], lease_s=float(sys.argv[3]))
endpoint.declare_alive("t/alive")
endpoint.receive(None)
"""


def test_a_port_in_use_is_one_clear_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        listen = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(TransportError) as caught:
            open_hub(listen)
    assert str(caught.value) == f"listen on {listen}: the port is in use"


def test_two_hubs_without_a_port_get_two() -> None:
    one, other = open_hub(), open_hub()
    try:
        assert one.locator != other.locator
        assert one.locator.startswith("tcp/127.0.0.1:")
    finally:
        one.close()
        other.close()


def test_an_endpoint_that_makes_no_sense_is_one_clear_line() -> None:
    with pytest.raises(TransportError) as caught:
        open_hub("nonsense")
    assert "nonsense" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_connecting_where_nobody_listens_fails_in_its_time() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        connect = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    start = time.monotonic()
    with pytest.raises(TransportError, match=f"connect to {connect}: no answer"):
        open_client(connect, timeout_s=0.3)
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize(
    ("identity", "problem"),
    [
        (None, "refuses sessions without keys"),
        (Password("cells-1", "guessed"), "the run refuses these keys: the password of cells-1 is another"),
    ],
    ids=["no keys", "password"],
)
def test_connecting_where_somebody_listens_and_refuses_says_so(
    identity: Identity | None, problem: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        connect = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(TransportError, match=f"connect to {connect}: somebody listens there.*{problem}"):
            open_client(connect, timeout_s=0.3, identity=identity)


def test_nobody_joins_by_accident() -> None:
    for config in (hub_config("tcp/127.0.0.1:7447"), client_config("tcp/127.0.0.1:7447")):
        assert config.get_json("scouting/multicast/enabled") == "false"
        assert config.get_json("scouting/gossip/enabled") == "false"


@pytest.mark.parametrize(
    ("how", "lease_s", "within_s"),
    [
        (signal.SIGKILL, 30.0, (0.0, 0.25)),  # nominally 10 ms: the rest is for a machine that does much else
        (signal.SIGSTOP, 0.6, (0.3, 0.6 * 1.1 + 0.25)),
    ],
    ids=["killed", "stopped"],
)
def test_a_killed_process_loses_its_token_at_once_and_a_stopped_one_with_its_lease(
    how: signal.Signals, lease_s: float, within_s: tuple[float, float]
) -> None:
    hub = open_hub()
    cell = subprocess.Popen([sys.executable, "-c", _CELL, ROOT, hub.locator, str(lease_s)])
    try:
        hub.watch_alive("t/alive")
        drain(hub, lambda events: ("t/alive", True) in tokens(events), timeout_s=20.0)
        start = time.monotonic()
        cell.send_signal(how)
        assert hub.receive(10.0) == LivelinessChange("t/alive", False)
        assert within_s[0] <= time.monotonic() - start <= within_s[1]
    finally:
        cell.kill()
        cell.wait()
        hub.close()


def test_a_listener_that_reads_nothing_holds_up_no_declaration_of_the_mirror() -> None:
    outside = open_outside(None, gate=AccessPolicy(None, '{"enabled": false}'))
    listener = subprocess.Popen(
        [sys.executable, "-c", _STUCK, ROOT, outside.locator], stdin=subprocess.PIPE, cwd=ROOT
    )
    try:
        publisher = outside.session.declare_publisher(
            "t/data", congestion_control=zenoh.CongestionControl.DROP
        )
        matching = cast("Any", publisher)
        while not matching.matching_status.matching:
            time.sleep(0.01)
        # 60 MB, more than its link's queue and sockets hold. Zenoh sends the first while the last are dropped.
        for _ in range(1_000):
            publisher.put(b"x" * 60_000)
            time.sleep(0.0005)
        begun = time.perf_counter()
        outside.declare_alive("t/token")
        assert time.perf_counter() - begun < 2.5, "half of what Zenoh would wait by itself"
    finally:
        listener.kill()
        listener.communicate()
        outside.close()


def _linger_s(port: int) -> list[tuple[int, int]]:
    """SO_LINGER, whether it is on and for how many seconds, of the links to a port of this process."""
    found: list[tuple[int, int]] = []
    for path in Path("/dev/fd").iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile, or not connected
            if not path.is_socket():
                continue
            with socket.socket(fileno=os.dup(int(path.name))) as link:
                if link.family == socket.AF_INET and link.getsockname()[1] == port and link.getpeername():
                    found.append(struct.unpack("ii", link.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)))
    return found


@pytest.mark.parametrize("open_session", [open_outside, open_hub])
def test_closing_a_link_over_tcp_never_waits_for_its_peer(
    open_session: Callable[..., ZenohEndpoint], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LingerReset, "_work", lambda _: None)
    listen = f"tcp/127.0.0.1:{free_port()}"
    hub = open_session(listen, gate=AccessPolicy(None, '{"enabled": false}'))
    port = int(listen.rpartition(":")[2])
    clients = [open_client(listen) for _ in range(3)]
    try:
        assert _linger_s(port) == [(1, 10)] * 3, "Zenoh doesn't set it any more: LingerReset can go"
        reset = LingerReset([port])
        assert reset.sweep() == 3
        assert [on for on, _ in _linger_s(port)] == [0] * 3
        assert reset.sweep() == 0
    finally:
        for client in clients:
            client.close()
        hub.close()


def test_links_are_reset_as_they_come() -> None:
    hub = open_outside(None, gate=AccessPolicy(None, '{"enabled": false}'))
    port = int(hub.locator.rpartition(":")[2])
    client = open_client(hub.locator)
    try:
        deadline = time.monotonic() + 5.0
        while [on for on, _ in _linger_s(port)] != [0]:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        client.close()
        hub.close()


def test_ports_are_those_of_tcp_and_tls() -> None:
    addresses = ("tcp/127.0.0.1:7447", "tls/[::1]:7448#iface=lo", "unixsock-stream//tmp/a:3", "udp/1.2.3.4:5")
    assert tcp_ports(addresses) == {7447, 7448}


def test_a_client_leaves_the_environment_as_it_was() -> None:
    code = "import os\nfrom bus.transports.zenoh import open_client, open_hub\n"
    code += "hub = open_hub()\nopen_client(hub.locator).close()\nhub.close()\n"
    code += "assert 'ZENOH_RUNTIME' not in os.environ\n"
    environment = {name: value for name, value in os.environ.items() if name != "ZENOH_RUNTIME"}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, timeout=60)


def test_a_payload_that_is_too_large_is_dropped_as_it_comes_in_and_the_next_arrives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("bus.transports.zenoh.session.LARGEST", 1_000_000)
    hub = open_hub()
    stranger = open_client(hub.locator)
    try:
        hub.subscribe("t/flood")
        flood = stranger.publisher("t/flood")
        settle(flood, hub)
        for payload in (b"a" * 900_000, b"b" * 4_000_000, b"c"):
            flood.put(payload)
        sizes = [len(payload) for payload in payloads(drain(hub, lambda events: b"c" in payloads(events)))]
        assert sizes == [900_000, 1]
    finally:
        stranger.close()
        hub.close()


_LISTENER = """
import sys
sys.path.insert(0, sys.argv[1])
from bus.transports.zenoh import open_client
endpoint = open_client(sys.argv[2])
endpoint.subscribe("t/flood")
endpoint.declare_alive("t/alive")
endpoint.receive(None)
sys.exit(7)
"""


def test_a_process_that_forgets_to_close_ends_at_once_though_payloads_come_in() -> None:
    hub = open_hub()
    flood = hub.publisher("t/flood")
    cell = subprocess.Popen([sys.executable, "-c", _LISTENER, ROOT, hub.locator])
    try:
        hub.watch_alive("t/alive")
        drain(hub, lambda events: ("t/alive", True) in tokens(events), timeout_s=20.0)
        start = time.monotonic()
        while cell.poll() is None and time.monotonic() - start < 8.0:
            flood.put(b"x" * 100)
            assert hub.receive(0.0002) in (None, LivelinessChange("t/alive", False))
        assert cell.wait(0.1) == 7
        assert time.monotonic() - start < 4.0
    finally:
        cell.kill()
        cell.wait()
        hub.close()


def test_a_forked_process_may_not_use_the_session_it_inherited() -> None:
    hub = open_hub()
    publisher = hub.publisher("t/a")
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        said = b""
        try:
            publisher.put(b"")
        except TransportError as error:
            said = str(error).encode()
        os.write(write, said)
        os._exit(0)
    os.close(write)
    os.waitpid(child, 0)
    said = os.read(read, 1000).decode()
    os.close(read)
    hub.close()
    assert "a forked process must open its own" in said


def test_a_signal_handler_runs_while_the_main_thread_waits() -> None:
    class Interrupted(Exception):
        pass

    def handler(number: int, frame: object) -> None:
        raise Interrupted

    hub = open_hub()
    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(Interrupted):
            hub.receive(None, enough=10)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        hub.close()


def test_a_signal_handler_runs_while_payloads_are_answered() -> None:
    class Interrupted(Exception):
        pass

    def handler(number: int, frame: object) -> None:
        raise Interrupted

    hub = open_hub()
    hub.subscribe("t/a", direct=True)
    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(Interrupted):
            hub.answer_payloads("t/a", lambda payload: True)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        hub.close()


@pytest.mark.parametrize("seed", range(4))
def test_payloads_keep_their_order_however_the_reader_takes_them(seed: int) -> None:
    """The reader has payloads answered in Zenoh's thread, waits for one, or looks, in turns; some answers refuse."""
    total, choose = 1500, random.Random(seed)
    hub = open_hub()
    cell = open_client(hub.locator)
    cell.subscribe("t/a", direct=True)
    publisher = hub.publisher("t/a")
    settle(publisher, cell)
    found, threads = list[int](), set[int]()

    def take(payload: bytes) -> bool:
        if choose.random() < 0.1:
            return False
        found.append(int(payload))
        threads.add(threading.get_ident())
        return True

    def sender() -> None:
        for i in range(total):
            publisher.put(b"%d" % i)
            if i % 3 == 0:
                time.sleep(0.001)

    thread = threading.Thread(target=sender)
    thread.start()
    deadline = time.monotonic() + 20.0
    while len(found) < total and time.monotonic() < deadline:
        timer = threading.Timer(0.5, cell.wake)  # the last payload may have been answered already
        timer.start()
        match choose.randrange(3):
            case 0:
                cell.answer_payloads("t/a", take)
            case 1:
                if (payload := cell.receive_payload("t/a")) is not None:
                    found.append(int(payload))
            case _:
                found += map(int, payloads(cell.receive_all(0.0)))
        timer.cancel()
    thread.join()
    for endpoint in (cell, hub):
        endpoint.close()
    assert found == list(range(total))
    assert threads
    assert threading.get_ident() not in threads


def test_a_wait_for_payloads_ends_with_its_time() -> None:
    hub = open_hub()
    try:
        hub.subscribe("t/*")
        for timeout_s in (0.02, 0.3):
            start = time.monotonic()
            assert hub.receive_all(timeout_s) == []
            assert timeout_s <= time.monotonic() - start < timeout_s + 0.5
    finally:
        hub.close()


def test_a_silent_cell_is_lost_by_the_wall_clock_while_its_token_stands() -> None:
    network = Network("zenoh")
    system = System(network, Partition.each(grid(1, 2)), "per_cell", stall=StallSpec(deadline_s=0.3)).start()
    try:
        system.host.publish(system.sense(0))
        system.members[0].gather(0)
        system.members[0].publish(system.drive(0, 0), None)
        start = time.monotonic()
        assert system.host.gather(0)[1] == [Loss(1, 0, "timed_out")]
        assert 0.3 <= time.monotonic() - start < 1.0
    finally:
        network.close()


def test_closing_an_endpoint_ends_another_thread_s_wait_for_payloads() -> None:
    hub = open_hub()
    hub.subscribe("t/*")
    said: list[str] = []

    def wait() -> None:
        try:
            hub.receive(None)
        except TransportError as error:
            said.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.05)
    hub.close()
    thread.join(5.0)
    assert said == ["this endpoint was closed while it waited"]


def test_a_stranger_s_deletion_is_no_payload() -> None:
    hub = open_hub()
    stranger = open_client(hub.locator)
    try:
        hub.subscribe("t/main")
        hub.subscribe("t/quiet", "quiet")
        publisher = stranger.publisher("t/main")
        settle(publisher, stranger)
        for key in ("t/quiet", "t/main"):
            stranger.session.delete(key)
        publisher.put(b"")
        assert hub.receive_all(5.0) == [Received("t/main", b"")]
    finally:
        stranger.close()
        hub.close()


def test_any_zenoh_tool_can_listen_to_the_drives() -> None:
    network = Network("zenoh")
    system = System(network, Partition.each(grid(1, 2)), "per_cell").start()
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{network.locator}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        listener = session.declare_subscriber("mdms/*/cell/*/*/drive")
        received: dict[str, dict[str, object]] = {}
        tick = 0
        while len(received) < 2:  # the subscription takes its time
            system.host.publish(system.sense(tick))
            for shard, member in enumerate(system.members):
                member.gather(tick)
                member.publish(system.drive(shard, tick), None)
            system.host.gather(tick)
            tick += 1
            while (sample := listener.try_recv()) is not None:
                received[str(sample.key_expr)] = msgpack.unpackb(sample.payload.to_bytes())
        listener.undeclare()
    network.close()
    assert sorted(received) == ["mdms/test/cell/0/0/drive", "mdms/test/cell/0/1/drive"]
    for key, fields in received.items():
        shard = int(key.split("/")[4])
        expected = system.drive(shard, fields["tick"]).drive[0].tolist()  # type: ignore[arg-type]
        assert fields == {"v": 2, "tick": fields["tick"], "drive": expected}


def test_sessions_close_fast() -> None:
    hub = open_hub()
    clients = [open_client(hub.locator) for _ in range(4)]
    for i, client in enumerate(clients):
        client.subscribe("t/*")
        client.declare_alive(f"t/alive/{i}")
    start = time.monotonic()
    for client in clients:
        client.close()
    hub.close()
    assert time.monotonic() - start < 1.5


def test_a_flood_does_not_keep_its_reader_for_ever() -> None:
    class Sample:
        key_expr = "t/flood"
        payload = zenoh.ZBytes(b"x")
        kind = zenoh.SampleKind.PUT

    class Endless:
        handler = SimpleNamespace(recv=Sample, try_recv=Sample)

    session = SimpleNamespace(declare_subscriber=lambda key, handler: Endless())
    events: list[Event] = []
    Channel(cast("Any", session), "t/flood").drain(events)
    assert len(events) == 65_536
