"""Where runs of this machine that go on can be spoken to: each leaves a note in its folder while it does."""

from __future__ import annotations

import json
import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, cast, final

from bus.errors import TransportError
from bus.wire.keys import plant_key
from deploy.control.requests import RequestError
from deploy.errors import DeployError, InputError
from deploy.security.session import operator_session
from deploy.util.files import write_text

FILE_NAME: Final = "live.json"


@final
@dataclass(frozen=True, slots=True)
class Address:
    """How to reach a run.

    Attributes:
        run: Its name.
        connect: Where its plant listens.
        pid: Of the plant's process.
    """

    run: str
    connect: str
    pid: int

    def write(self, folder: Path) -> None:
        """Leave the note."""
        write_text(folder / FILE_NAME, json.dumps(asdict(self)))

    @staticmethod
    def remove(folder: Path) -> None:
        """Take the note away, where there is one."""
        with suppress(OSError):
            (folder / FILE_NAME).unlink()


@contextmanager
def advertise(run: str, locator: str, folder: Path) -> Generator[None]:
    """Leave a note in a run's folder, while it goes on, of where it can be spoken to.

    Args:
        run: Its name.
        locator: Where its plant listens; empty: nowhere, and there is no note.
        folder: The run's.
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
    """The run of a folder; None: the one below ``runs/`` that began last and still goes on.

    Raises:
        InputError: There is none.
    """
    if folder is not None:
        address = _read(folder / FILE_NAME)
        if address is None:
            raise InputError(f"--run {folder}: no run goes on there")
        return address
    notes = sorted(Path("runs").glob(f"*/{FILE_NAME}"), key=_age)
    for note in notes:
        address = _read(note)
        if address is not None:
            return address
    raise InputError(
        "no run goes on below runs/: name its folder with --run, or where it listens with --connect"
    )


def _age(note: Path) -> float:
    try:
        return -note.stat().st_mtime
    except OSError:
        return 0.0


def _read(note: Path) -> Address | None:
    """What a note says; None where its run is over, however it ended."""
    try:
        data: dict[str, Any] = json.loads(note.read_bytes())
        address = Address(str(data["run"]), str(data["connect"]), int(data["pid"]))
        os.kill(address.pid, 0)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return address


def ask_run(
    connect: str, request: dict[str, Any], timeout_s: float, keys: Path | None = None
) -> dict[str, Any]:
    """Ask the run whose plant listens there.

    Args:
        connect: Where, such as ``tcp/127.0.0.1:7447``.
        request: See ``deploy.control.requests``.
        timeout_s: Wall seconds to wait for its answer.
        keys: The run's, or the operator's folder of them; None where the run has none.

    Returns:
        The answer: ``run``, ``tick``, ``time_s``, and what belongs to the request.

    Raises:
        InputError: Nobody listens there, or they let nobody in with these keys.
        RequestError: The run refuses; says why.
        DeployError: It doesn't answer in time.
    """
    from bus.transports.zenoh.requests import send_request

    endpoint = operator_session(connect, timeout_s, keys)
    try:
        text = send_request(endpoint, plant_key("*", "operator"), json.dumps(request).encode(), timeout_s)
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
