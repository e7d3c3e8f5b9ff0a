"""Every transport keeps the promises of ``bus.transports.base.Endpoint``."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from bus.errors import TransportError
from bus.transports.base import Event, LivelinessChange, Received, Wakeup
from tests.bus.support import Network, drain, payloads, settle, tokens


def test_a_payload_arrives_as_it_was_put_with_its_key(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/a")
    publisher = plant.publisher("t/a")
    settle(publisher, cell)
    sent = [b"", b"\x00\xff", bytes(range(256)) * 400]
    for payload in sent:
        publisher.put(payload)
    events = drain(cell, lambda events: len(events) == 3)
    assert events == [Received("t/a", payload) for payload in sent]


def test_puts_of_one_endpoint_arrive_in_order_over_all_its_keys_each_once(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/*/x")
    publishers = [plant.publisher(f"t/{i}/x") for i in range(5)]
    for publisher in publishers:
        settle(publisher, cell)
    sent = [(f"t/{i % 5}/x", str(i).encode()) for i in range(2000)]
    for i, (_, payload) in enumerate(sent):
        publishers[i % 5].put(payload)
    events = drain(cell, lambda events: len(events) == len(sent))
    assert [(e.key, e.payload) for e in events if isinstance(e, Received)] == sent
    assert cell.receive(0.05) is None


def test_clients_receive_each_other_through_the_plant(network: Network) -> None:
    network.endpoint()
    one, other = network.endpoint(), network.endpoint()
    other.subscribe("t/a")
    publisher = one.publisher("t/a")
    settle(publisher, other)
    publisher.put(b"hello")
    assert other.receive(5.0) == Received("t/a", b"hello")


def test_every_subscriber_gets_a_copy_the_sender_included(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/**")
    cell.subscribe("t/a")
    publisher = cell.publisher("t/a")
    settle(publisher, cell)
    publisher.put(b"1")
    assert cell.receive(5.0) == Received("t/a", b"1")
    while (event := plant.receive(0.5)) is None:  # The plant's subscription may have been the later one.
        publisher.put(b"1")
    assert event == Received("t/a", b"1")


def test_late_joiners_get_nothing_of_what_was_put_before(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    publisher = plant.publisher("t/a")
    publisher.put(b"before")
    cell.subscribe("t/a")
    settle(publisher, cell)
    publisher.put(b"after")
    assert cell.receive(5.0) == Received("t/a", b"after")


def test_a_publisher_is_unmatched_until_somebody_subscribes(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    publisher = plant.publisher("t/a")
    assert not publisher.matched()
    cell.subscribe("t/b")
    assert cell.receive(0.05) is None
    assert not publisher.matched()
    cell.subscribe("t/a")
    settle(publisher, cell)
    assert publisher.matched()


def test_overlapping_subscriptions_are_refused_and_equal_ones_are_one(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/*/x")
    cell.subscribe("t/*/x")
    with pytest.raises(TransportError, match=r"t/1/x: overlaps t/\*/x"):
        cell.subscribe("t/1/x")
    publisher = plant.publisher("t/1/x")
    settle(publisher, cell)
    publisher.put(b"once")
    assert cell.receive(5.0) == Received("t/1/x", b"once")
    assert cell.receive(0.05) is None


def test_a_watcher_receives_tokens_that_exist_appear_and_disappear(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.declare_alive("t/1/alive")
    plant.watch_alive("t/*/alive")
    drain(plant, lambda events: ("t/1/alive", True) in tokens(events))
    cell.declare_alive("t/2/alive")
    drain(plant, lambda events: ("t/2/alive", True) in tokens(events))
    cell.withdraw("t/1/alive")
    events = drain(plant, lambda events: ("t/1/alive", False) in tokens(events))
    assert ("t/2/alive", False) not in tokens(events)


def test_closing_an_endpoint_withdraws_its_tokens(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.watch_alive("t/*")
    cell.declare_alive("t/a")
    drain(plant, lambda events: ("t/a", True) in tokens(events))
    cell.close()
    drain(plant, lambda events: ("t/a", False) in tokens(events))


def test_what_was_put_arrives_before_the_loss_of_the_token(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/data")
    plant.watch_alive("t/alive")
    cell.declare_alive("t/alive")
    publisher = cell.publisher("t/data")
    drain(plant, lambda events: ("t/alive", True) in tokens(events))
    settle(publisher, cell)
    for i in range(500):
        publisher.put(str(i).encode())
    cell.withdraw("t/alive")
    events = drain(plant, lambda events: ("t/alive", False) in tokens(events))
    assert payloads(events) == [str(i).encode() for i in range(500)]


def test_withdrawing_a_token_that_was_never_declared_is_harmless_and_declaring_twice_is_not(
    network: Network,
) -> None:
    endpoint = network.endpoint()
    endpoint.withdraw("t/never")
    endpoint.declare_alive("t/a")
    with pytest.raises(TransportError, match="t/a is declared already"):
        endpoint.declare_alive("t/a")


def test_receive_returns_none_when_the_time_is_up(network: Network) -> None:
    endpoint = network.endpoint()
    assert endpoint.receive(0) is None
    start = time.monotonic()
    assert endpoint.receive(0.05) is None
    assert endpoint.receive_all(0.05) == []
    assert 0.09 < time.monotonic() - start < 2.0


def test_wake_ends_a_wait_from_another_thread(network: Network) -> None:
    endpoint = network.endpoint()
    waker = threading.Timer(0.05, endpoint.wake)
    waker.start()
    assert endpoint.receive(None, enough=100) == Wakeup()
    waker.join()


def test_wake_before_a_wait_is_not_lost(network: Network) -> None:
    endpoint = network.endpoint()
    endpoint.wake()
    assert endpoint.receive(5.0) == Wakeup()


def test_a_patient_wait_ends_with_enough_payloads_with_a_token_or_with_its_time(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/data")
    plant.subscribe("t/urgent", "urgent")
    plant.watch_alive("t/alive")
    data, urgent = cell.publisher("t/data"), cell.publisher("t/urgent")
    settle(data, cell)
    settle(urgent, cell)

    data.put(b"1")
    data.put(b"2")
    assert payloads(plant.receive_all(5.0, enough=2)) == [b"1", b"2"]

    data.put(b"3")
    urgent.put(b"4")
    assert payloads(plant.receive_all(5.0, enough=100)) == [b"3", b"4"]

    data.put(b"5")
    cell.declare_alive("t/alive")
    assert plant.receive_all(5.0, enough=100) == [Received("t/data", b"5"), LivelinessChange("t/alive", True)]

    data.put(b"6")
    assert plant.receive_all(0.2, enough=100) == [Received("t/data", b"6")]


def test_quiet_payloads_end_no_wait_and_come_before_what_ends_it(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/quiet/*", "quiet")
    plant.subscribe("t/data")
    quiet, data = cell.publisher("t/quiet/1"), cell.publisher("t/data")
    settle(quiet, cell)
    settle(data, cell)

    quiet.put(b"1")
    quiet.put(b"2")
    data.put(b"3")
    expected = [Received("t/quiet/1", b"1"), Received("t/quiet/1", b"2"), Received("t/data", b"3")]
    assert plant.receive_all(5.0) == expected

    start = time.monotonic()
    quiet.put(b"4")
    assert plant.receive_all(0.2) == [Received("t/quiet/1", b"4")]
    assert time.monotonic() - start > 0.15


def test_a_wait_for_a_quiet_payload_ends_with_it_whether_it_is_there_or_comes(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/data")
    plant.subscribe("t/quiet/1", "quiet")
    plant.subscribe("t/quiet/2", "quiet")
    one, two = cell.publisher("t/quiet/1"), cell.publisher("t/quiet/2")
    settle(one, cell)
    settle(two, cell)
    for wait_s in (None, 20.0):
        one.put(b"there")
        two.put(b"there")
        expected = {Received("t/quiet/1", b"there"), Received("t/quiet/2", b"there")}
        events: list[Event] = []
        while len(events) < 2:
            events += plant.receive_all(wait_s, 1, "t/quiet/2" if not events else "t/quiet/1")
        assert set(events) == expected
        later = threading.Timer(0.05, lambda: two.put(b"comes"))
        start = time.monotonic()
        later.start()
        assert plant.receive_all(wait_s, 1, "t/quiet/2") == [Received("t/quiet/2", b"comes")]
        assert 0.04 < time.monotonic() - start < 10.0
        later.join()


def test_a_wait_for_a_quiet_payload_ends_with_what_is_urgent_a_token_or_its_time(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/data")
    plant.subscribe("t/quiet", "quiet")
    plant.subscribe("t/urgent", "urgent")
    urgent, data = cell.publisher("t/urgent"), cell.publisher("t/data")
    settle(urgent, cell)
    settle(data, cell)
    plant.watch_alive("t/alive")
    ways: list[tuple[Callable[[], object], Event]] = [
        (lambda: urgent.put(b"now"), Received("t/urgent", b"now")),
        (lambda: cell.declare_alive("t/alive"), LivelinessChange("t/alive", True)),
        (plant.wake, Wakeup()),
    ]
    for end, event in ways:
        ends = threading.Timer(0.05, end)
        ends.start()
        assert plant.receive_all(None, 1, "t/quiet") == [event]
        ends.join()
    assert plant.receive_all(0.05, 1, "t/quiet") == []
    # The next wait is for other payloads again.
    data.put(b"1")
    assert plant.receive_all(None) == [Received("t/data", b"1")]


def test_receive_takes_one_at_a_time_and_leaves_the_rest(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/a")
    publisher = cell.publisher("t/a")
    settle(publisher, cell)
    for payload in (b"1", b"2", b"3"):
        publisher.put(payload)
    assert [plant.receive(5.0, enough=3 - i) for i in range(3)] == [
        Received("t/a", payload) for payload in (b"1", b"2", b"3")
    ]


def test_a_payload_that_comes_alone_is_received_without_its_event(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/a")
    publisher = plant.publisher("t/a")
    settle(publisher, cell)
    for payload in (b"1", b"", b"\x00" * 70_000):
        publisher.put(payload)
        assert cell.receive_payload("t/a") == payload
    publisher.put(b"2")
    assert cell.receive_payload("t/b") is None
    assert cell.receive_all(0.0) == [Received("t/a", b"2")]


def test_a_payload_that_does_not_come_alone_is_left_with_the_others(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/a")
    cell.subscribe("t/urgent", "urgent")
    publisher, urgent = plant.publisher("t/a"), plant.publisher("t/urgent")
    for one in (publisher, urgent):
        settle(one, cell)
    publisher.put(b"1")
    urgent.put(b"now")
    found = list[Event]()
    while len(found) < 2:
        payload = cell.receive_payload("t/a")  # alone, if the urgent one is still under way
        found += cell.receive_all(0.0) if payload is None else [Received("t/a", payload)]
    assert found == [Received("t/a", b"1"), Received("t/urgent", b"now")]
    cell.wake()
    assert cell.receive_payload("t/a") is None
    assert cell.receive_all(0.0) == [Wakeup()]
    publisher.put(b"2")
    assert cell.receive_payload("t/a") == b"2"


def test_payloads_are_answered_as_they_come_until_one_is_refused(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/a")
    plant.subscribe("t/answer")
    publisher, back = plant.publisher("t/a"), cell.publisher("t/answer")
    settle(publisher, cell)
    settle(back, plant)
    running, overlaps = threading.Lock(), list[bytes]()

    def answer(payload: bytes) -> bool:
        if not running.acquire(blocking=False):
            overlaps.append(payload)
        if payload != b"no":
            back.put(payload)
        running.release()
        return payload != b"no"

    def sender() -> None:
        for i in range(200):
            publisher.put(b"%d" % i)
            assert plant.receive(5.0) == Received("t/answer", b"%d" % i)
        publisher.put(b"no")
        publisher.put(b"later")

    thread = threading.Thread(target=sender)
    thread.start()
    left = list[Event]()
    while not left:
        cell.answer_payloads("t/a", answer)
        left = cell.receive_all(0.0)
    thread.join()
    left += drain(cell, lambda events: len(left) + len(events) == 2)
    assert left == [Received("t/a", b"no"), Received("t/a", b"later")]
    assert overlaps == []


def test_no_payload_is_answered_before_an_urgent_one_that_was_put_before_it(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/a")
    cell.subscribe("t/urgent", "urgent")
    publisher, urgent = plant.publisher("t/a"), plant.publisher("t/urgent")
    for one in (publisher, urgent):
        settle(one, cell)
    answered, left = list[bytes](), list[Event]()

    def answer(payload: bytes) -> bool:
        answered.append(payload)
        return True

    for i in range(50):
        thread = threading.Thread(target=lambda i=i: (urgent.put(b"%d" % i), publisher.put(b"%d" % i)))
        thread.start()
        while len(left) < 2 * i + 2:
            cell.answer_payloads("t/a", answer)
            left += cell.receive_all(0.0)
            if len(left) == 2 * i + 1:  # the payload is under way
                left += drain(cell, lambda events: len(events) == 1)
        thread.join()
    assert answered == []
    for i in range(50):
        assert set(left[2 * i : 2 * i + 2]) == {Received(key, b"%d" % i) for key in ("t/urgent", "t/a")}


def test_answers_end_for_a_wakeup_and_raise_what_the_callee_raises(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    cell.subscribe("t/a")
    publisher = plant.publisher("t/a")
    settle(publisher, cell)
    cell.wake()
    cell.answer_payloads("t/a", lambda payload: True)
    assert cell.receive_all(0.0) == [Wakeup()]

    def fail(payload: bytes) -> bool:
        raise ValueError(payload.decode())

    def answer_all() -> None:
        while True:  # a payload that comes before the wait is not answered in it
            timer = threading.Timer(0.02, publisher.put, (b"broken",))
            timer.start()
            cell.answer_payloads("t/a", fail)
            cell.receive_all(0.0)
            timer.join()

    with pytest.raises(ValueError, match="broken"):
        answer_all()


def test_closing_twice_is_harmless_and_a_closed_endpoint_says_so(network: Network) -> None:
    endpoint = network.endpoint()
    publisher = endpoint.publisher("t/a")
    endpoint.close()
    endpoint.close()
    for use in (
        lambda: publisher.put(b""),
        publisher.matched,
        lambda: endpoint.publisher("t/b"),
        lambda: endpoint.subscribe("t/b"),
        lambda: endpoint.declare_alive("t/b"),
        lambda: endpoint.watch_alive("t/b"),
        lambda: endpoint.receive(0),
    ):
        with pytest.raises(TransportError, match="closed"):
            use()


def test_threads_may_put_while_another_waits(network: Network) -> None:
    plant, cell = network.endpoint(), network.endpoint()
    plant.subscribe("t/*")
    publishers = [cell.publisher(f"t/{i}") for i in range(4)]
    for publisher in publishers:
        settle(publisher, cell)
    threads = [
        threading.Thread(target=lambda p=publisher: [p.put(str(i).encode()) for i in range(300)])
        for publisher in publishers
    ]
    for thread in threads:
        thread.start()
    events = drain(plant, lambda events: len(events) == 1200)
    for thread in threads:
        thread.join()
    for i in range(4):
        mine = [e.payload for e in events if isinstance(e, Received) and e.key == f"t/{i}"]
        assert mine == [str(n).encode() for n in range(300)]
