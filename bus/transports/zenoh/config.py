"""Settings of the plant's and the cells' sessions; docs/bus.md says what each is for."""

from __future__ import annotations

import re
from typing import Any, Final, cast

import zenoh

from bus.errors import TransportError

LARGEST: Final = 1 << 28
"""Bytes of the largest payload that comes in: several times the senses of a million cells."""
LEASE_S: Final = 2.0
"""Silence after which the other side takes a process for gone; each session's own lease governs its token."""


def hub_config(listen: str, lease_s: float = LEASE_S) -> zenoh.Config:
    """Settings of the plant's session.

    Args:
        listen: Endpoint such as ``tcp/127.0.0.1:7447``.
        lease_s: Seconds of silence after which the others take the plant for gone.
    """
    config = _config("peer", lease_s)
    _set(config, "listen/endpoints", f'["{listen}"]')
    _set(config, "listen/exit_on_failure", "true")
    # Shared memory is off in every session: with it a hub stops near 350 sessions.
    _set(config, "transport/unicast/max_sessions", "20000")
    _set(config, "transport/unicast/accept_pending", "2000")
    return config


def client_config(connect: str, lease_s: float = LEASE_S, timeout_s: float = 10.0) -> zenoh.Config:
    """Settings of a cell process.

    Args:
        connect: The plant's endpoint.
        lease_s: Seconds of silence after which the plant takes this process for gone.
        timeout_s: Seconds to go on trying while nobody listens there.
    """
    config = _config("client", lease_s)
    _set(config, "connect/endpoints", f'["{connect}"]')
    _set(config, "connect/timeout_ms", str(round(timeout_s * 1000)))
    _set(config, "connect/exit_on_failure", "true")
    _set(config, "connect/retry", "{period_init_ms: 20, period_max_ms: 200, period_increase_factor: 2}")
    _set(config, "listen/endpoints", "[]")
    return config


def _config(mode: str, lease_s: float) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, "mode", f'"{mode}"')
    _set(config, "scouting/multicast/enabled", "false")
    _set(config, "scouting/gossip/enabled", "false")
    _set(config, "transport/shared_memory/enabled", "false")
    # One queue a link: with priorities a token's withdrawal overtakes the data put before it.
    _set(config, "transport/unicast/qos/enabled", "false")
    # Longer ones are dropped piece by piece; by default a stranger's may take 1 GiB.
    _set(config, "transport/link/rx/max_message_size", str(LARGEST))
    _set(config, "transport/link/tx/lease", str(round(lease_s * 1000)))
    _set(config, "open/return_conditions/connect_scouted", "false")
    return config


def _set(config: zenoh.Config, key: str, json: str) -> None:
    try:
        cast("Any", config).insert_json5(key, json)
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh refuses {key} = {json}: {first_line(error)}") from None


def first_line(error: BaseException) -> str:
    """What went wrong, without Zenoh's trace."""
    lines = str(error).splitlines()
    return re.sub(r" at \S+\.rs:\d+\.?", "", lines[0]) if lines else type(error).__name__
