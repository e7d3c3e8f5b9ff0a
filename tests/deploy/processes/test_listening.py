"""Where the plant may listen, and how its own processes reach it there."""

from __future__ import annotations

import pytest

from deploy.errors import InputError
from deploy.processes.listening import Kind, check_listening, host_of, near

HERE = (
    "tcp/127.0.0.1:7447",
    "tcp/localhost:7447",
    "tcp/[::1]:7447",
    "tcp/127.9.9.9:1#so_sndbuf=9",
    "unixpipe/x",
)
BEYOND = (
    "tcp/0.0.0.0:7447",
    "tcp/[::]:7447",
    "tcp/10.0.0.5:7447",
    "udp/plant.local:7447",
    "tcp/127.0.0.1.evil:1",
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


def test_certificates_and_tls_go_together() -> None:
    with pytest.raises(InputError, match=r"must be tls/, such as tls/127.0.0.1:7447"):
        check_listening("tcp/127.0.0.1:7447", "certificate", insecure=True)
    with pytest.raises(InputError, match="tls/ needs certificates"):
        check_listening("tls/127.0.0.1:7447", None, insecure=True)


def test_who_listens_everywhere_is_reached_on_loopback() -> None:
    assert near("tls/0.0.0.0:7447") == "tls/127.0.0.1:7447"
    assert near("tcp/[::]:7447") == "tcp/[::1]:7447"
    assert near("tcp/10.0.0.5:7447") == "tcp/10.0.0.5:7447"
    assert [host_of(endpoint) for endpoint in HERE[:3]] == ["127.0.0.1", "localhost", "::1"]
