"""Frames of a running simulation for viewers, and their encoding."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Final, Literal, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from deploy.errors import DeployError

VERSION: Final = 1
LONGEST: Final = 256 * 1024 * 1024
"""Longest frame that is decoded, bytes."""
ALIVE, FAULTY, LOST = 0, 1, 2
"""Health of a cell: as it should be; with an active fault; dead or lost."""

State = Literal["running", "paused", "ended"]
_pack = cast("Any", msgpack).packb
_unpack = cast("Any", msgpack).unpackb


@final
@dataclass(frozen=True, slots=True, eq=False)
class RunFrame:
    """State of a running simulation between two ticks.

    Attributes:
        tick: The next tick.
        time_s: Simulated time, s.
        parcels: ``(m, 6)`` x, y, angle and their rates, m and rad.
        in_play: ``(m,)`` parcels on the surface: fed, and not gone through an exit.
        status: Status of each parcel, such as ``moving`` or ``tipped``.
        wheel_speeds: ``(n, 2)`` float32, m/s.
        presence: ``(n, sensors)`` presence bits.
        health: ``(n,)`` ``ALIVE``, ``FAULTY`` or ``LOST``.
        state: Whether the run is running, paused or has ended.
        speed: Simulated seconds per wall second that the run keeps to; None: as fast as possible.
        real_time_factor: Simulated seconds per wall second, measured.
        lag_s: Lag behind the wall clock at that speed, wall seconds.
        events: Events of the plant since the client's last frame, as in the recording.
        faults: Faults and losses since then, likewise.
        first_event: Number of the first of ``events`` in the run; some are missing if it is greater than expected.
    """

    tick: int
    time_s: float
    parcels: NDArray[np.float64]
    in_play: NDArray[np.bool_]
    status: tuple[str, ...]
    wheel_speeds: NDArray[np.float32]
    presence: NDArray[np.bool_]
    health: NDArray[np.uint8]
    state: State
    speed: float | None
    real_time_factor: float
    lag_s: float
    events: tuple[dict[str, Any], ...]
    faults: tuple[dict[str, Any], ...]
    first_event: int = 0

    def encode(self, header: Any = None) -> bytes:
        """Return the frame as MessagePack; ``header``: JSON value that goes with it, or None."""
        presence = self.presence
        fields = {
            "v": VERSION,
            "tick": self.tick,
            "time_s": self.time_s,
            "parcels": self.parcels.astype("<f8", copy=False).tobytes(),
            "in_play": self.in_play.tobytes(),
            "status": list(self.status),
            "wheel_speeds": self.wheel_speeds.astype("<f4", copy=False).tobytes(),
            "presence": [presence.shape[1], np.packbits(presence, bitorder="little").tobytes()],
            "health": self.health.tobytes(),
            "state": self.state,
            "speed": self.speed,
            "real_time_factor": self.real_time_factor,
            "lag_s": self.lag_s,
            "events": json.dumps(self.events),
            "faults": json.dumps(self.faults),
            "first_event": self.first_event,
            "header": None if header is None else json.dumps(header),
        }
        return cast("bytes", _pack(fields))


def decode(payload: bytes) -> tuple[RunFrame, Any]:
    """Return a frame, and the header that came with it, or None.

    Raises:
        DeployError: The payload is no frame.
    """
    if len(payload) > LONGEST:
        raise DeployError(f"a frame of {len(payload)} bytes: must be at most {LONGEST}")
    try:
        return _decoded(_unpack(payload))
    except (
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        msgpack.UnpackException,
        RecursionError,
    ) as error:
        raise DeployError(f"not a frame of a run: {type(error).__name__}: {error}") from None


def _decoded(fields: dict[str, Any]) -> tuple[RunFrame, Any]:
    if fields["v"] != VERSION:
        raise ValueError(
            f"version {fields['v']}: must be {VERSION}; the run has another version of this package"
        )
    health = np.frombuffer(fields["health"], np.uint8)
    n, in_play = len(health), np.frombuffer(fields["in_play"], np.bool_)
    sensors, bits = fields["presence"]
    if len(bits) != -(-n * sensors // 8):
        raise ValueError(f"{len(bits)} bytes of presence bits for {n} cells with {sensors} sensors")
    presence = np.unpackbits(np.frombuffer(bits, np.uint8), count=n * sensors, bitorder="little")
    frame = RunFrame(
        tick=int(fields["tick"]),
        time_s=float(fields["time_s"]),
        parcels=np.frombuffer(fields["parcels"], "<f8").reshape(len(in_play), 6),
        in_play=in_play,
        status=tuple(map(str, fields["status"])),
        wheel_speeds=np.frombuffer(fields["wheel_speeds"], "<f4").reshape(n, 2),
        presence=presence.reshape(n, sensors).astype(np.bool_),
        health=health,
        state=fields["state"],
        speed=fields["speed"],
        real_time_factor=float(fields["real_time_factor"]),
        lag_s=float(fields["lag_s"]),
        events=tuple(json.loads(fields["events"])),
        faults=tuple(json.loads(fields["faults"])),
        first_event=int(fields["first_event"]),
    )
    header = fields["header"]
    return frame, None if header is None else json.loads(header)
