"""Operator's session with a run of another process."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bus.errors import TransportError
from deploy.errors import InputError

if TYPE_CHECKING:
    from bus.transports.zenoh import ZenohEndpoint


def operator_session(connect: str, timeout_s: float, keys: Path | None) -> ZenohEndpoint:
    """Connect to a run's plant as an operator.

    Args:
        connect: Endpoint on which the plant listens, such as ``tcp/127.0.0.1:7447``.
        timeout_s: Wall time to keep trying, s.
        keys: Folder of the run's or the operator's keys; None if the run has none.

    Raises:
        InputError: It is no endpoint, no plant listens there, it doesn't accept the keys, or the folder has no keys.
    """
    from bus.transports.zenoh import open_client

    if "/" not in connect:
        raise InputError(f"--connect {connect}: must be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447")
    if keys is None and connect.startswith("tls/"):
        raise InputError(f"{connect}: tls/ needs certificates: --keys DIR, the run's or the operator's")
    identity = None
    if keys is not None:
        from deploy.security.keyring import operator_of

        identity = operator_of(keys)
        if (identity.kind == "certificate") != connect.startswith("tls/"):
            raise InputError(
                f"{connect}: certificates go with tls/, passwords don't; {keys}: a {identity.kind}"
            )
    try:
        return open_client(connect, timeout_s=timeout_s, identity=identity)
    except TransportError as error:
        raise InputError(f"--connect {connect}: {error}") from None
