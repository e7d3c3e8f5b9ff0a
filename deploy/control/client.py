"""Client of running simulations; each run on this machine advertises an address file in its folder."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast, final

from bus.errors import TransportError
from bus.wire.keys import plant_key
from deploy.errors import DeployError, InputError, RequestError
from deploy.security.session import operator_session
from deploy.util.files import write_text

if TYPE_CHECKING:
    from bus.transports.zenoh import ZenohEndpoint

FILE_NAME: Final = "live.json"
_AGAIN_S: Final = 0.05
"""Interval at which a run that is still starting is asked again, wall seconds."""
_TOKENS_S: Final = 2.0
"""Longest wait for the names of the runs at an endpoint, wall seconds."""


@final
@dataclass(frozen=True, slots=True)
class Address:
    """Address of a run.

    Attributes:
        run: Name of the run.
        connect: Endpoint on which the plant listens.
        pid: Process id of the plant's process.
    """

    run: str
    connect: str
    pid: int

    def write(self, folder: Path) -> None:
        """Write the address file."""
        write_text(folder / FILE_NAME, json.dumps(asdict(self)))

    @staticmethod
    def remove(folder: Path) -> None:
        """Remove the address file if it exists."""
        with suppress(OSError):
            (folder / FILE_NAME).unlink()


@contextmanager
def advertise(run: str, locator: str, folder: Path) -> Generator[None]:
    """Keep an address file in a run's folder inside the context.

    Args:
        run: Name of the run.
        locator: Endpoint on which the plant listens; empty: none, and no file is written.
        folder: Folder of the run.
    """
    if not locator:
        yield
        return
    address = Address(run, locator, os.getpid())
    address.write(folder)
    try:
        yield
    finally:
        address.remove(folder)


def discover(folder: Path | None) -> Address:
    """Return the address of a run in progress.

    Args:
        folder: Folder of the run; None: the newest run in progress below ``runs/``.

    Raises:
        InputError: No run is in progress there.
    """
    if folder is not None:
        address = _read(folder / FILE_NAME)
        if address is None:
            raise InputError(f"--run {folder}: no run in progress writes there")
        return address
    notes = sorted(Path("runs").glob(f"*/{FILE_NAME}"), key=_age)
    for note in notes:
        address = _read(note)
        if address is not None:
            return address
    raise InputError(
        "no run is in progress below runs/: give its folder with --run, or its endpoint with --connect"
    )


def _age(note: Path) -> float:
    try:
        return -note.stat().st_mtime
    except OSError:
        return 0.0


def _read(note: Path) -> Address | None:
    """Read an address file; None if the file is unusable or its process has ended."""
    try:
        data: dict[str, Any] = json.loads(note.read_bytes())
        address = Address(str(data["run"]), str(data["connect"]), int(data["pid"]))
        os.kill(address.pid, 0)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return address


ANY_RUN: Final = "*"
"""In place of a run's name: the only one at an endpoint."""


def ask_run(
    connect: str, request: dict[str, Any], timeout_s: float, keys: Path | None = None, run: str = ANY_RUN
) -> dict[str, Any]:
    """Send a request to a run, and return the answer.

    Args:
        connect: Endpoint on which the plant listens, such as ``tcp/127.0.0.1:7447``.
        request: See ``deploy.control.server``.
        timeout_s: Wall time to wait for the answer, s.
        keys: Folder of the run's or the operator's keys; None if the run has none.
        run: Name of the run; ``ANY_RUN``: the only one there.

    Returns:
        The answer: ``run``, ``tick``, ``time_s``, and the fields of this kind of request.

    Raises:
        InputError: No plant listens there, the plant doesn't accept the keys, or a router carries several runs.
        RequestError: The run refuses the request; the message says why.
        DeployError: The run doesn't answer in time.
    """
    endpoint = operator_session(connect, timeout_s, keys)
    try:
        return ask_at(endpoint, connect, request, timeout_s, only_run(endpoint, connect, run))
    finally:
        endpoint.close()


def ask_status(connect: str, run: str, timeout_s: float, keys: Path | None = None) -> dict[str, Any]:
    """Return the status of a run, which it answers at any time: see ``deploy.workers.status``.

    Args:
        connect: Endpoint on which the plant or a router listens.
        run: Name of the run; ``ANY_RUN``: the only one there.
        timeout_s: Wall time to wait for the answer, s.
        keys: Folder of the run's or the operator's keys; None if the run has none.

    Raises:
        InputError: As of ``ask_run``.
        DeployError: The run doesn't answer in time.
    """
    endpoint = operator_session(connect, timeout_s, keys)
    try:
        name = only_run(endpoint, connect, run)
        return ask_at(endpoint, connect, {}, timeout_s, name, "status")
    finally:
        endpoint.close()


def runs_at(endpoint: ZenohEndpoint) -> list[str]:
    """Return the names of the runs whose plants are at an endpoint.

    Raises:
        TransportError: The session is closed.
    """
    from bus.transports.zenoh.requests import tokens_at

    tokens = tokens_at(endpoint, plant_key(ANY_RUN, "alive"), _TOKENS_S)
    return sorted({key.split("/")[1] for key in tokens})


def only_run(endpoint: ZenohEndpoint, connect: str, run: str) -> str:
    """Return the name of the run to ask.

    Raises:
        InputError: It is not named, and there are several.
    """
    if run != ANY_RUN:
        return run
    names = runs_at(endpoint)
    if len(names) > 1:
        raise InputError(f"{connect}: there are several runs, name one of them (--run): {', '.join(names)}")
    return names[0] if names else ANY_RUN


def ask_at(
    endpoint: ZenohEndpoint,
    connect: str,
    request: dict[str, Any],
    timeout_s: float,
    run: str = ANY_RUN,
    leaf: Literal["operator", "status"] = "operator",
) -> dict[str, Any]:
    """Send a request over an open session, and return the answer; see ``ask_run``.

    Raises:
        RequestError: The run refuses the request; the message says why.
        DeployError: The run doesn't answer in time.
    """
    try:
        payload = json.dumps(request).encode()
        answer = _answer(json.loads(_sent(endpoint, plant_key(run, leaf), payload, timeout_s)))
    except TransportError as error:
        raise DeployError(f"{connect}: {absence(endpoint, run) or error}") from None
    except (ValueError, RecursionError):
        raise DeployError(f"{connect}: the answer is not from a run") from None
    if not answer["ok"]:
        raise RequestError(*answer["problems"])
    return answer


def _sent(endpoint: ZenohEndpoint, key: str, payload: bytes, timeout_s: float) -> bytes:
    """Send a request, again and again while the run is still starting; return the response."""
    from bus.transports.zenoh.requests import NoResponderError, send_request

    left_s = timeout_s
    while True:
        begun = time.monotonic()
        try:
            return send_request(endpoint, key, payload, left_s)
        except NoResponderError:
            time.sleep(_AGAIN_S)
            left_s -= time.monotonic() - begun
            if left_s <= 0.0:
                raise


def absence(endpoint: ZenohEndpoint, run: str) -> str:
    """Say which runs there are in place of one that doesn't answer; empty: it is there, or there are none."""
    try:
        names = runs_at(endpoint)
    except TransportError:
        return ""
    if run == ANY_RUN or not names or run in names:
        return ""
    return f"no run {run} is here; there are: {', '.join(names)} (--run)"


def _answer(found: object) -> dict[str, Any]:
    """Return a decoded answer after a check of its common fields."""
    if isinstance(found, dict):
        answer = cast("dict[str, Any]", found)
        if answer.get("ok") is True or (
            answer.get("ok") is False and isinstance(answer.get("problems"), list)
        ):
            return answer
    raise ValueError("no answer")
