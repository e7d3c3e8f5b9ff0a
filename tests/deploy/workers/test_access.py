"""The two ways into a run: the cells' is closed, the listeners' has everything and lets nothing in but questions."""

from __future__ import annotations

import json
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest
import zenoh

from bus.spec import StallSpec
from bus.transports.base import LivelinessChange, Received
from bus.transports.zenoh import ZenohEndpoint, open_client
from bus.transports.zenoh.requests import send_request
from deploy.errors import InputError
from deploy.scenes.files import load_scene
from deploy.scenes.scene import Scene
from deploy.workers.access import Access
from deploy.workers.plan import RunOptions, plan
from tests.system.listener import plain_client

PATIENCE_S = 10.0


@pytest.fixture(scope="module")
def motors() -> Scene:
    return load_scene("motors")


@contextmanager
def opened(scene: Scene, **options: Any) -> Iterator[tuple[Access, ZenohEndpoint]]:
    given = RunOptions(2, **options)
    access = Access(plan(scene, given, "test"), StallSpec(), given, None)
    hub: ZenohEndpoint | None = None
    try:
        hub = access.open()
        yield access, hub
    finally:
        access.close()
        if hub is not None:
            hub.close()


def until(found: Callable[[], bool]) -> None:
    """Waits until something is so."""
    deadline = time.monotonic() + PATIENCE_S
    while not found():
        assert time.monotonic() < deadline, "it never was so"
        time.sleep(0.002)


def all_of(subscriber: Any, number: int) -> list[tuple[str, bytes]]:
    """The first messages of a plain subscriber."""
    found: list[tuple[str, bytes]] = []

    def take() -> bool:
        while (sample := subscriber.try_recv()) is not None:
            found.append((str(sample.key_expr), sample.payload.to_bytes()))
        return len(found) >= number

    until(take)
    return found


def test_cells_join_in_a_folder_of_this_user_s_alone_that_goes_with_the_run(motors: Scene) -> None:
    with opened(motors) as (access, hub):
        path = Path(access.join.partition("/")[2])
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        assert [address.partition("/")[0] for address in hub.listening] == ["unixsock-stream"]
        assert access.locator.startswith("tcp/127.0.0.1:")
        open_client(access.join).close()
    assert not path.parent.exists()


def test_listeners_have_every_kind_of_message_and_the_tokens_and_nothing_is_copied_for_nobody(
    motors: Scene,
) -> None:
    with opened(motors, wire="packed") as (access, hub), plain_client(access.locator) as listener:
        cells = open_client(access.join)
        kinds = ("sense", "drive", "to/1", "report", "registers", "snapshot")
        keys = ["plant/control", *(f"shard/0/{leaf}" for leaf in kinds)]
        publishers = {
            key: (hub if key.startswith("plant") or key.endswith("sense") else cells).publisher(
                f"mdms/test/{key}"
            )
            for key in keys
        }
        cells.declare_alive("mdms/test/shard/0/alive")
        assert not any(publisher.matched() for publisher in publishers.values())
        subscriber = cast("Any", listener.declare_subscriber("mdms/*/shard/*/drive"))
        until(publishers["shard/0/drive"].matched)
        assert not any(publisher.matched() for key, publisher in publishers.items() if key != "shard/0/drive")
        subscriber.undeclare()
        until(lambda: not publishers["shard/0/drive"].matched())
        subscriber = cast("Any", listener.declare_subscriber("mdms/**"))
        until(lambda: all(publisher.matched() for publisher in publishers.values()))
        hub.subscribe("mdms/test/shard/*/drive")
        hub.wake()  # by a deletion on such a key
        for key, publisher in publishers.items():
            publisher.put(key.encode())
        found = all_of(subscriber, len(keys))
        assert sorted(found) == sorted((f"mdms/test/{key}", key.encode()) for key in keys)
        tokens = {
            str(reply.ok.key_expr)
            for reply in cast("Any", listener.liveliness()).get("mdms/**", timeout=PATIENCE_S)
        }
        assert tokens == {"mdms/test/shard/0/alive"}
        gone = cast("Any", listener.liveliness().declare_subscriber("mdms/**"))
        cells.close()
        assert gone.recv().kind == zenoh.SampleKind.DELETE


def test_what_a_listener_puts_reaches_neither_the_run_nor_other_listeners(motors: Scene) -> None:
    with (
        opened(motors) as (access, hub),
        plain_client(access.locator) as forger,
        plain_client(access.locator) as listener,
    ):
        cells = open_client(access.join)
        for endpoint in (hub, cells):
            endpoint.subscribe("mdms/test/shard/0/*")
            endpoint.watch_alive("mdms/**")
        subscriber = cast("Any", listener.declare_subscriber("mdms/**"))
        honest = cells.publisher("mdms/test/shard/0/drive")
        until(honest.matched)
        heard: list[bytes] = []

        def mirrored() -> bool:
            """Put until the mirror, which begins when somebody listens, passes something on."""
            honest.put(b"early")
            while (sample := subscriber.try_recv()) is not None:
                heard.append(sample.payload.to_bytes())
            return bool(heard)

        until(mirrored)
        token = forger.liveliness().declare_token("mdms/test/shard/0/alive")
        for _ in range(10):
            forger.put("mdms/test/shard/0/drive", b"forged", congestion_control=zenoh.CongestionControl.BLOCK)
            forger.delete("mdms/test/shard/0/drive", congestion_control=zenoh.CongestionControl.BLOCK)
        honest.put(b"honest")

        def passed_on() -> bool:
            while (sample := subscriber.try_recv()) is not None:
                heard.append(sample.payload.to_bytes())
            return heard[-1] == b"honest"

        until(passed_on)
        assert set(heard[:-1]) == {b"early"}
        for endpoint in (hub, cells):
            early, last = (Received("mdms/test/shard/0/drive", data) for data in (b"early", b"honest"))
            while (received := endpoint.receive(PATIENCE_S)) == early:
                pass
            assert received == last
            assert endpoint.receive(0.1) is None
        assert not list(cast("Any", listener.liveliness()).get("mdms/**", timeout=1.0))
        del token
        cells.close()


def test_operators_ask_where_listeners_listen(motors: Scene) -> None:
    with opened(motors) as (access, _):
        questions = access.questions("mdms/test/plant/operator")
        operator = open_client(access.locator)
        answers: list[bytes] = []
        asking = threading.Thread(
            target=lambda: answers.append(send_request(operator, "mdms/*/plant/operator", b"?", PATIENCE_S))
        )
        asking.start()
        while (question := questions.drain()) is None:
            time.sleep(0.002)
        question.answer(json.dumps("!").encode())
        asking.join()
        operator.close()
        assert answers == [b'"!"']


def test_port_0_is_a_free_port_that_is_told(motors: Scene) -> None:
    with opened(motors, listen="tcp/127.0.0.1:0") as (access, _):
        assert access.locator.startswith("tcp/127.0.0.1:")
        assert int(access.locator.rpartition(":")[2]) > 0
        plain_client(access.locator).close()


def test_what_zenoh_listens_on_beyond_this_host_is_closed_again(
    motors: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bus.transports.zenoh.endpoint._addresses", lambda _: ("tcp/10.0.0.5:1",))
    with pytest.raises(InputError, match=r"--join tcp/10.0.0.5:1: leaves this host"), opened(motors):
        pass


def test_a_token_of_the_run_is_known_to_its_own(motors: Scene) -> None:
    with opened(motors) as (access, hub):
        hub.watch_alive("mdms/test/shard/*/alive")
        cells = open_client(access.join)
        cells.declare_alive("mdms/test/shard/0/alive")
        assert hub.receive(PATIENCE_S) == LivelinessChange("mdms/test/shard/0/alive", True)
        cells.close()


def test_a_router_passes_on_to_its_own_listeners_what_the_mirror_has(motors: Scene) -> None:
    with opened(motors) as (access, _):
        with socket.create_server(("127.0.0.1", 0)) as probe:
            where = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        config = cast("Any", zenoh.Config())
        for key, value in (
            ("mode", "router"),
            ("listen/endpoints", [where]),
            ("scouting/multicast/enabled", False),
        ):
            config.insert_json5(key, json.dumps(value))
        config.insert_json5("connect/endpoints", json.dumps([access.locator]))
        with zenoh.open(config), plain_client(where) as listener:
            subscriber = cast("Any", listener.declare_subscriber("mdms/**"))
            cells = open_client(access.join)
            drive = cells.publisher("mdms/test/shard/0/drive")
            until(drive.matched)
            drive.put(b"drive")
            assert all_of(subscriber, 1) == [("mdms/test/shard/0/drive", b"drive")]
            cells.close()
