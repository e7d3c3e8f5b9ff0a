"""Asks a run something, from another process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

from bus.errors import TransportError
from bus.keys import plant_key
from deploy.errors import DeployError
from deploy.keys.session import operator_session
from deploy.live.request import RequestError


def ask_run(
    connect: str, request: dict[str, Any], timeout_s: float, keys: Path | None = None
) -> dict[str, Any]:
    """Ask the run whose plant listens there.

    Args:
        connect: Where, such as ``tcp/127.0.0.1:7447``.
        request: See ``deploy.live.request``.
        timeout_s: Wall seconds to wait for its answer.
        keys: The run's, or the operator's folder of them; None where the run has none.

    Returns:
        The answer: ``run``, ``tick``, ``time_s``, and what belongs to the request.

    Raises:
        InputError: Nobody listens there, or they let nobody in with these keys.
        RequestError: The run refuses; says why.
        DeployError: It doesn't answer in time.
    """
    from bus.transports.zenoh.questions import ask

    endpoint = operator_session(connect, timeout_s, keys)
    try:
        text = ask(endpoint, plant_key("*", "operator"), json.dumps(request).encode(), timeout_s)
        answer = _answer(json.loads(text))
    except TransportError as error:
        raise DeployError(f"{connect}: {error}") from None
    except (ValueError, RecursionError):
        raise DeployError(f"{connect}: what answers there is no run") from None
    finally:
        endpoint.close()
    if not answer["ok"]:
        raise RequestError(*answer["problems"])
    return answer


def _answer(found: object) -> dict[str, Any]:
    """What is a run's answer, as far as every answer is alike."""
    if isinstance(found, dict):
        answer = cast("dict[str, Any]", found)
        if answer.get("ok") is True or (
            answer.get("ok") is False and isinstance(answer.get("problems"), list)
        ):
            return answer
    raise ValueError("no answer")
