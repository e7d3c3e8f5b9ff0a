"""Client of a running simulation: frames, control, faults and registers, over one session."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self, cast, final

from bus.errors import TransportError
from bus.wire.keys import plant_key
from deploy.control.client import ANY_RUN, ask_at, discover, only_run
from deploy.control.registers import Cell, RegisterReadings, registers_key, request_registers
from deploy.errors import DeployError
from deploy.live.frame import RunFrame, decode
from deploy.security.session import operator_session

if TYPE_CHECKING:
    from collections.abc import Iterable

    from deploy.recordings.format import Header

_ATTEMPT_S: Final = 0.5
"""Wall time to wait for an answer before the request is repeated, while the run begins."""


@final
class RunWaitsError(DeployError):
    """The run waits for its cells: nothing can be seen yet."""


@final
class LiveRun:
    """A running simulation of another process, seen and controlled.

    ::

        with mdms.LiveRun.attach() as run:  # the newest below runs/
            run.pause()
            run.step(10)
            frame = run.frame()
            run.inject("crash", cell=[3, 4])
            run.resume()

    Args:
        connect: Endpoint on which the plant listens, such as ``tcp/127.0.0.1:7447``.
        keys: Folder of the run's or the operator's keys; None if the run has none.
        timeout_s: Wall time to wait for an answer, s.
        run: Name of the run, where a router carries several.

    Attributes:
        connect: As given.
        header: Header of the run, as of its recording.

    Raises:
        InputError: No plant listens there, the plant doesn't accept the keys, or there are several runs and none is
            named.
        RunWaitsError: The run still waits for its cells.
        DeployError: The run doesn't answer in time.
    """

    def __init__(
        self, connect: str, keys: Path | None = None, timeout_s: float = 5.0, run: str = ANY_RUN
    ) -> None:
        self.connect, self._timeout_s = connect, timeout_s
        self._endpoint = operator_session(connect, timeout_s, keys)
        self._events = self._faults = 0
        self._subscribed = False
        try:
            self._run = only_run(self._endpoint, connect, run)
            frame, header = self._begin(time.monotonic() + timeout_s)
        except BaseException:
            self._endpoint.close()
            raise
        self.header: Header = header
        self._run = str(header["run"])
        self._tick = frame.tick

    @classmethod
    def attach(
        cls, folder: Path | str | None = None, keys: Path | None = None, timeout_s: float = 5.0
    ) -> Self:
        """Attach to the run that writes to a folder; None: the newest run in progress below ``runs/``.

        Raises:
            InputError: No run is in progress there.
            DeployError: The run doesn't answer in time.
        """
        found = discover(None if folder is None else Path(folder))
        return cls(found.connect, keys, timeout_s, found.run)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _begin(self, deadline: float) -> tuple[RunFrame, Header]:
        """Return the first frame and the header."""
        while True:
            try:
                payload = self._ask_frame(_ATTEMPT_S, header=True)
                frame, header = decode(payload)
                return frame, cast("Header", header)
            except TransportError as error:  # the run may still be starting
                if time.monotonic() >= deadline:
                    self._check_begun()
                    raise DeployError(f"{self.connect}: {error}") from None
                time.sleep(0.05)

    def _check_begun(self) -> None:
        """Raise RunWaitsError if the run is there, and waits for its cells."""
        found = ask_at(self._endpoint, self.connect, {}, _ATTEMPT_S, self._run, "status")
        if found["state"] == "waiting":
            raise RunWaitsError(
                f"{self.connect}: run {found['run']} waits for {found['missing']} of {found['shards']} shards"
            )

    def _ask_frame(self, timeout_s: float, *, header: bool = False) -> bytes:
        from bus.transports.zenoh.requests import send_request

        request = {"events": self._events, "faults": self._faults, "header": header}
        return send_request(
            self._endpoint, plant_key(self._run, "view"), json.dumps(request).encode(), timeout_s
        )

    # --- what the run shows -------------------------------------------------------------------------

    def frame(self) -> RunFrame:
        """Return the state of the run now, between two ticks, with the events and faults since the last frame.

        Raises:
            DeployError: The run doesn't answer: it has ended, or a tick takes longer than the timeout.
        """
        try:
            frame, _ = decode(self._ask_frame(self._timeout_s))
        except TransportError as error:
            raise DeployError(f"{self.connect}: {error}") from None
        self._events = frame.first_event + len(frame.events)
        self._faults += len(frame.faults)
        return frame

    def registers(self, cells: Iterable[Cell] = ()) -> RegisterReadings:
        """Return the registers of cells after their last tick; none named: of all.

        Raises:
            InputError: Cells are missing or dead.
            DeployError: No registers arrived in time.
        """
        if not self._subscribed:
            self._endpoint.subscribe(registers_key(self._run))
            self._subscribed = True
        while self._endpoint.receive(0.0) is not None:
            pass  # older ones
        wanted = set(cells)
        deadline, most = time.monotonic() + self._timeout_s, len(self.header["cells"])
        found = request_registers(self._endpoint, self.connect, wanted, deadline, most, self._run)
        found.cells = {cell: own for cell, own in found.cells.items() if not wanted or cell in wanted}
        return found

    # --- control -----------------------------------------------------------------------------------

    def request(self, request: dict[str, Any], timeout_s: float | None = None) -> dict[str, Any]:
        """Send a request, see ``deploy.control.requests``; return the answer.

        Raises:
            RequestError: The run refuses the request; the message says why.
            DeployError: The run doesn't answer in time.
        """
        return ask_at(self._endpoint, self.connect, request, timeout_s or self._timeout_s, self._run)

    def status(self) -> dict[str, Any]:
        """Return the run's tick, time, state, speed, real-time factor and lag."""
        return self.request({"op": "status"})

    def pause(self) -> dict[str, Any]:
        """Pause before the next tick; return the answer, with its tick."""
        return self.request({"op": "pause"})

    def resume(self) -> dict[str, Any]:
        """Go on after a pause."""
        return self.request({"op": "resume"})

    def step(self, ticks: int = 1, timeout_s: float | None = None) -> dict[str, Any]:
        """Run some ticks of a paused run; return when it has paused again."""
        return self.request({"op": "step", "ticks": ticks}, timeout_s)

    def speed(self, factor: float | None) -> dict[str, Any]:
        """Set the simulated seconds per wall second; None: as fast as possible."""
        return self.request({"op": "speed", "factor": factor})

    def move(self, parcel: int, x_m: float, y_m: float, angle_rad: float) -> dict[str, Any]:
        """Put a parcel of a paused run elsewhere, at rest."""
        return self.request({"op": "move", "parcel": parcel, "x_m": x_m, "y_m": y_m, "angle_rad": angle_rad})

    def inject(self, kind: str, *, for_s: float | None = None, **keys: Any) -> int:
        """Inject a fault; return its number.

        Args:
            kind: Kind of the fault.
            for_s: Simulated time until the repair, s; None: no repair.
            **keys: The fault's other keys, such as ``cell=[3, 4]``; see ``docs/faults.md``.
        """
        return int(self.request({"op": "inject", "fault": {"kind": kind, **keys}, "for_s": for_s})["number"])

    def repair(self, number: int) -> dict[str, Any]:
        """Repair a fault."""
        return self.request({"op": "repair", "number": number})

    def faults(self) -> list[dict[str, Any]]:
        """Return the faults of the run so far."""
        return self.request({"op": "list"})["faults"]

    def reset(self) -> dict[str, Any]:
        """End the run, and begin it again in a new folder."""
        return self.request({"op": "reset"})

    def stop(self) -> dict[str, Any]:
        """End the run."""
        return self.request({"op": "stop"})

    def close(self) -> None:
        """Close the session; the run goes on."""
        self._endpoint.close()
