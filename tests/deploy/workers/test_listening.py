"""Endpoints that the plant may listen on, and how processes of the same host reach them."""

from __future__ import annotations

import pytest

from deploy.errors import InputError
from deploy.workers.listening import Kind, check_listening, check_opened, host_of, loopback_address, socket_in

HERE = (
    "tcp/127.0.0.1:7447",
    "tcp/localhost:7447",
    "tcp/[::1]:7447",
    "tcp/127.9.9.9:1#so_sndbuf=9",
    "tcp/127.0.0.1:1#iface=lo",
    "tcp/127.1:7447",
    "udp/127.0.0.1:7447",
    "unixsock-stream//tmp/x",
    "unixpipe/x",
)
BEYOND = (
    "tcp/0.0.0.0:7447",
    "tcp/[::]:7447",
    "tcp/10.0.0.5:7447",
    "tcp/[::ffff:10.0.0.5]:7447",
    "tcp/0:7447",
    "tcp/127.0.0.1:7447#iface=eth0",
    "quic/0.0.0.0:7447",
    "ws/0.0.0.0:7447",
    "vsock/1:7447",
    "udp/plant.invalid:7447",
    "tcp/127.0.0.1.invalid:1",
)
NO_ENDPOINT = (
    'tcp/127.0.0.1:1#","tcp/0.0.0.0:7449',
    "tcp/127.0.0.1:1,tcp/0.0.0.0:2",
    "tcp/127.0.0.1:1 tcp/0.0.0.0:2",
    "tcp/127.0.0.1",
    "tcp/:7447",
    "tcp/::1:7447",
    "tcp/127.0.0.1:1\\u0022",
)


@pytest.mark.parametrize("listen", HERE)
@pytest.mark.parametrize("kind", [None, "password"])
def test_anybody_may_listen_on_this_host(listen: str, kind: Kind | None) -> None:
    check_listening(listen, kind, insecure=False)


@pytest.mark.parametrize("listen", BEYOND)
def test_beyond_this_host_it_takes_certificates_or_a_word(listen: str) -> None:
    with pytest.raises(InputError, match=r"leaves this host, and anybody .* --keys DIR .* or --insecure"):
        check_listening(listen, None, insecure=False)
    with pytest.raises(InputError, match="leaves this host, and with passwords"):
        check_listening(listen, "password", insecure=False)
    check_listening(listen, None, insecure=True)
    check_listening("tls/" + listen.partition("/")[2], "certificate", insecure=False)


@pytest.mark.parametrize("listen", NO_ENDPOINT)
@pytest.mark.parametrize("kind", [None, "certificate"])
def test_whatever_is_not_one_endpoint_is_refused_even_with_insecure(listen: str, kind: Kind | None) -> None:
    with pytest.raises(InputError, match="must be one endpoint, PROTOCOL/HOST:PORT"):
        check_listening(listen, kind, insecure=True)


def test_a_name_is_as_local_as_all_of_its_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    addresses = {"both": ["127.0.0.1", "10.0.0.5"], "here": ["127.0.0.1", "::1"]}
    monkeypatch.setattr(
        "deploy.workers.listening.socket.getaddrinfo",
        lambda host, _: [(0, 0, 0, "", (address, 0)) for address in addresses[host]],
    )
    check_listening("tcp/here:1", None, insecure=False)
    with pytest.raises(InputError, match="leaves this host"):
        check_listening("tcp/both:1", None, insecure=False)


def test_what_is_listened_on_counts_not_what_was_asked_for() -> None:
    check_opened("tcp/localhost:1", ["tcp/127.0.0.1:1", "tcp/[::1]:1"], None, insecure=False)
    with pytest.raises(InputError, match=r"tcp/10.0.0.5:1: leaves this host"):
        check_opened("tcp/localhost:1", ["tcp/127.0.0.1:1", "tcp/10.0.0.5:1"], None, insecure=False)
    with pytest.raises(InputError, match="doesn't report the address"):
        check_opened("ws/localhost:1", [], None, insecure=False)
    check_opened("tcp/0.0.0.0:1", ["tcp/10.0.0.5:1"], None, insecure=True)
    check_opened("tls/0.0.0.0:1", ["tls/10.0.0.5:1"], "certificate", insecure=False)


def test_cells_join_over_a_socket_or_with_keys_or_a_word() -> None:
    check_listening(socket_in("/tmp/x"), None, insecure=False, option="--join")
    check_listening("tcp/127.0.0.1:1", "password", insecure=False, option="--join")
    check_listening("tcp/127.0.0.1:1", None, insecure=True, option="--join")
    with pytest.raises(InputError, match=r"--join tcp/127.0.0.1:1: anybody on this host could drive"):
        check_listening("tcp/127.0.0.1:1", None, insecure=False, option="--join")
    with pytest.raises(InputError, match=r"--join tcp/10.0.0.5:1: leaves this host, .* could join"):
        check_listening("tcp/10.0.0.5:1", None, insecure=False, option="--join")


def test_certificates_and_tls_go_together() -> None:
    with pytest.raises(InputError, match=r"must be tls/, such as tls/127.0.0.1:7447"):
        check_listening("tcp/127.0.0.1:7447", "certificate", insecure=True)
    with pytest.raises(InputError, match="tls/ needs certificates"):
        check_listening("tls/127.0.0.1:7447", None, insecure=True)


def test_who_listens_everywhere_is_reached_on_loopback() -> None:
    assert loopback_address("tls/0.0.0.0:7447") == "tls/127.0.0.1:7447"
    assert loopback_address("tcp/[::]:7447") == "tcp/[::1]:7447"
    assert loopback_address("tcp/10.0.0.5:7447") == "tcp/10.0.0.5:7447"
    assert [host_of(endpoint) for endpoint in HERE[:3]] == ["127.0.0.1", "localhost", "::1"]
