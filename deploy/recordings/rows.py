"""Messages of ``/tick`` of a recording, and the arrays that they make."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.recordings.changes import ChangeEncoded, Decode, PackedValues, Place
from deploy.recordings.format import Header
from deploy.recordings.mcap_reader import Message

UNPACKED_BYTES: Final = 64 << 20
"""Bytes of a recording's values beyond which these stay as the file has them, and are unpacked when asked for."""


@final
class _Field:
    """A field of ``/tick``, written when it changes.

    Attributes:
        places: Place of each written value.
        unpacked: The written values; None: there are too many.
        index: Number of the written value at each instant.
    """

    def __init__(self) -> None:
        self.places: list[Place] = []
        self.unpacked: list[bytes] | None = []
        self.index: list[int] = []
        self._sizes = set[int]()

    def write(self, place: Place, value: object) -> int:
        """Add a value; return its bytes."""
        if not isinstance(value, bytes):
            raise TypeError(f"{place.key} must be bytes, not {type(value).__name__}")
        self._sizes.add(len(value))
        self.places.append(place)
        if self.unpacked is None:
            return 0
        self.unpacked.append(value)
        return len(value)

    def repeat(self, other: _Field) -> None:
        """Add the value that another field has last."""
        self.places.append(other.places[-1])
        if self.unpacked is not None and other.unpacked is not None:
            self.unpacked.append(other.unpacked[-1])

    def next_instant(self) -> None:
        """Note that an instant has the value written last; before there is any, the first."""
        self.index.append(max(len(self.places) - 1, 0))

    def encoded(self, name: str, size: int, decode: Decode) -> ChangeEncoded:
        """Return the values; one of zeros where instants have none, as drives of a run of no ticks.

        Args:
            name: Name of the field.
            size: Bytes of a value.
            decode: Decodes values side by side, ``(k size,)`` bytes to ``(k, ...)``.
        """
        if self._sizes - {size}:
            raise ValueError(f"{name} must be {size} bytes")
        index = np.array(self.index, dtype=np.int64)
        if self.unpacked is None and self.places:
            return ChangeEncoded(PackedValues(self.places, lambda value: decode(value)[0]), index)
        unpacked = self.unpacked or [bytes(size)] * bool(self.index)
        return ChangeEncoded(decode(b"".join(unpacked)), index)


@final
class TickRows:
    """Messages of ``/tick``: an absent field keeps its previous value, and no wheel speeds are the drives before."""

    def __init__(self) -> None:
        self._ticks: list[int] = []
        self._times: list[int] = []
        self._fields = {name: _Field() for name in ("presence", "drives", "wheel_speeds", "parcels")}
        self._held = [field for name, field in self._fields.items() if name != "parcels"]
        self._unpacked = 0

    def add(self, message: Message, content: dict[str, Any]) -> None:
        """Add a message.

        Args:
            message: The message.
            content: Its content, decoded.

        Raises:
            TypeError, LookupError: It is no such message.
        """
        if type(content["tick"]) is not int:
            raise TypeError("a tick must be an integer")
        self._ticks.append(content["tick"])
        self._times.append(message.time_ns)
        stop = message.start + len(message.data)
        if "wheel_speeds" in content and content["wheel_speeds"] is None:
            self._fields["wheel_speeds"].repeat(self._fields["drives"])
            del content["wheel_speeds"]
        for name, field in self._fields.items():
            if name in content:
                self._unpacked += field.write(Place(message.chunk, message.start, stop, name), content[name])
            field.next_instant()
        if self._unpacked > UNPACKED_BYTES:
            for field in self._held:
                field.unpacked = None

    def arrays(self, header: Header) -> dict[str, Any]:
        """Return the arguments of ``Recording`` that come from the ticks."""
        cells, sensors, parcels = (len(header[name]) for name in ("cells", "sensors_m", "footprints_m"))
        return {
            "tick": np.array(self._ticks, dtype=np.int64),
            "time_ns": np.array(self._times, dtype=np.int64),
            "parcels": self._numbers("parcels", (parcels, 6)).all(),
            "held_presence": self._bits("presence", (cells, sensors)),
            "held_drives": self._numbers("drives", (cells, 2)),
            "held_wheel_speeds": self._numbers("wheel_speeds", (cells, 2)),
        }

    def _numbers(self, name: str, shape: tuple[int, int]) -> ChangeEncoded:
        width = shape[0] * shape[1]

        def decode(values: bytes) -> NDArray[np.float64]:
            numbers = np.frombuffer(values, dtype="<f8").astype(np.float64, copy=False)
            return numbers.reshape(-1 if width else 1, *shape)

        return self._fields[name].encoded(name, 8 * width, decode)

    def _bits(self, name: str, shape: tuple[int, int]) -> ChangeEncoded:
        width = shape[0] * shape[1]
        size = (width + 7) // 8

        def decode(values: bytes) -> NDArray[np.bool_]:
            rows = np.frombuffer(values, dtype=np.uint8).reshape(-1 if size else 1, size)
            bits = np.unpackbits(rows, axis=1, count=width, bitorder="little")
            return bits.astype(np.bool_).reshape(len(rows), *shape)

        return self._fields[name].encoded(name, size, decode)
