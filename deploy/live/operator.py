"""Asks a run something, from another process."""

from __future__ import annotations

import json
from typing import Any

from bus.errors import TransportError
from bus.keys import plant_key
from deploy.errors import DeployError, InputError
from deploy.live.request import RequestError


def ask_run(connect: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
    """Ask the run whose plant listens there.

    Args:
        connect: Where, such as ``tcp/127.0.0.1:7447``.
        request: See ``deploy.live.request``.
        timeout_s: Wall seconds to wait for its answer.

    Returns:
        The answer: ``run``, ``tick``, ``time_s``, and what belongs to the request.

    Raises:
        InputError: Nobody listens there, or nothing that could answer.
        RequestError: The run refuses; says why.
        DeployError: It doesn't answer in time.
    """
    from bus.transports.zenoh import open_client
    from bus.transports.zenoh.questions import ask

    try:
        endpoint = open_client(connect, timeout_s=timeout_s)
    except TransportError as error:
        raise InputError(f"--connect {connect}: {error}") from None
    try:
        text = ask(endpoint, plant_key("*", "operator"), json.dumps(request).encode(), timeout_s)
        answer: dict[str, Any] = json.loads(text)
    except TransportError as error:
        raise DeployError(f"{connect}: {error}") from None
    finally:
        endpoint.close()
    if not answer["ok"]:
        raise RequestError(*answer["problems"])
    return answer
