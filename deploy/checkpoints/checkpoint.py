"""What a run is at a boundary of ticks: all that it takes to go on from there, as bytes that say if they are whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final, cast, final

from bus.errors import StateError
from bus.lockstep.counters import MessageCounters
from bus.state_codec import decode, encode
from deploy.errors import InputError

MAGIC: Final = b"MDMS checkpoint\n"
FORMAT: Final = 1
"""Raised when older checkpoints can no longer be read."""
LARGEST_BYTES: Final = 4 << 30
_HEAD: Final = len(MAGIC) + 2 + sha256().digest_size


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A run before ``tick``, all ticks before that being over.

    Attributes:
        scene_name: The bundled name or the file as given.
        scene: The whole scene, in JSON's types.
        bound: What the bits hang on: the scene's digest, versions, machine, the firmware's file.
        options: How it was run, as far as a resumed run has to be run alike.
        tick: The first that is not over.
        time_ns: Simulated time reached.
        process: What the plant's process remembers.
        states: What the cells remember, by shard; of those that had cells left.
        ledger: What was counted, and the digest.
        reporter: What the protocol's report has gathered; None where there is to be none.
        counts: Payloads of all sides: sent, delivered, lost, late.
        refused: Payloads that were, by whose key they were put on and name of the error.
        tally: What cells counted whose processes have left.
        recorded: Messages of the recording by topic: those that are of ticks that are over.
        dead: Indices of the cells that had gone.
        wall_s: Of the ticks that are over.
        resumed: Ticks before which the run had been resumed, in order.
    """

    scene_name: str
    scene: dict[str, Any]
    bound: dict[str, str]
    options: dict[str, Any]
    tick: int
    time_ns: int
    process: bytes
    states: dict[int, bytes]
    ledger: bytes
    reporter: bytes | None
    counts: tuple[int, int, int, int]
    refused: dict[tuple[str, str], int]
    tally: dict[str, int]
    recorded: dict[str, int]
    dead: tuple[int, ...]
    wall_s: float
    resumed: tuple[int, ...]

    def all_counts(self) -> MessageCounters:
        """The counts as the bus has them."""
        counts = MessageCounters(*self.counts)
        counts.refused.update(self.refused)
        counts.cell_counters.update(self.tally)
        return counts

    def to_bytes(self) -> bytes:
        """The file's content."""
        body = encode({name: getattr(self, name) for name in _TYPES}, {})
        head = MAGIC + FORMAT.to_bytes(2, "little")
        return head + sha256(head + body).digest() + body

    @classmethod
    def from_bytes(cls, content: bytes) -> Checkpoint:
        """What ``to_bytes`` was called on.

        Raises:
            InputError: The content is not whole, was changed, or is of another format: says which.
        """
        if not content.startswith(MAGIC) or len(content) < _HEAD:
            raise InputError("not a checkpoint, or cut at its beginning")
        head, body = content[: len(MAGIC) + 2], content[_HEAD:]
        version = int.from_bytes(head[len(MAGIC) :], "little")
        if version != FORMAT:
            raise InputError(f"of format {version}: this version reads format {FORMAT}")
        if sha256(head + body).digest() != content[len(head) : _HEAD]:
            raise InputError("cut or changed: its checksum is not that of its content")
        try:
            values = decode(body, {})
        except StateError as error:
            raise InputError(str(error)) from None
        _check(values)
        return cls(**values)


_TYPES: Final[Mapping[str, tuple[type, ...]]] = {
    "scene_name": (str,),
    "scene": (dict,),
    "bound": (dict,),
    "options": (dict,),
    "tick": (int,),
    "time_ns": (int,),
    "process": (bytes,),
    "states": (dict,),
    "ledger": (bytes,),
    "reporter": (bytes, type(None)),
    "counts": (tuple,),
    "refused": (dict,),
    "tally": (dict,),
    "recorded": (dict,),
    "dead": (tuple,),
    "wall_s": (float,),
    "resumed": (tuple,),
}
_ITEMS: Final[Mapping[str, tuple[type, type]]] = {
    "bound": (str, str),
    "states": (int, bytes),
    "refused": (tuple, int),
    "tally": (str, int),
    "recorded": (str, int),
}
"""Of maps whose keys and values are all of one type."""


def _check(values: Any) -> None:
    """Refuse what is not a checkpoint's fields.

    Raises:
        InputError: Names the field.
    """
    if not isinstance(values, dict) or set(cast("Any", values)) != set(_TYPES):
        raise InputError(f"must hold {', '.join(_TYPES)}")
    found = cast("dict[str, Any]", values)
    for name, kinds in _TYPES.items():
        if type(found[name]) not in kinds:
            raise InputError(f"{name}: must be {' or '.join(kind.__name__ for kind in kinds)}")
    for name, (key, value) in _ITEMS.items():
        if any(type(k) is not key or type(v) is not value for k, v in found[name].items()):
            raise InputError(f"{name}: must map {key.__name__} to {value.__name__}")
    for name in ("counts", "dead", "resumed"):
        if any(type(number) is not int or number < 0 for number in found[name]):
            raise InputError(f"{name}: must be numbers from 0")
    if len(found["counts"]) != 4 or found["tick"] < 1:
        raise InputError("counts: must be four numbers; tick: must be at least 1")
