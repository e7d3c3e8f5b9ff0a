"""Checkpoint of a run at a tick boundary: everything needed to resume, as bytes with a checksum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final, cast, final

from bus.errors import StateError
from bus.lockstep.counters import MessageCounters
from bus.lockstep.snapshots import MessageBytes
from bus.state_codec import decode, encode
from deploy.errors import InputError

MAGIC: Final = b"MDMS checkpoint\n"
FORMAT: Final = 4
"""Raised when older checkpoints can no longer be read."""
LARGEST_BYTES: Final = 4 << 30
_HEAD: Final = len(MAGIC) + 2 + sha256().digest_size


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """State of a run before ``tick``, after all earlier ticks are complete.

    Attributes:
        scene_name: Bundled name of the scene, or the file as given.
        scene: The whole scene, in JSON's types.
        bound: Fingerprint of the run, by name: the scene's digest, versions, machine, the firmware's file.
        options: Options that a resumed run must share.
        tick: First tick that is not complete.
        time_ns: Simulated time reached, ns.
        process: State of the plant's process.
        states: State of the cells, by shard; only shards with a live cell.
        links: Messages that were on their way to a shard, by shard, a tick each: whether there is one on each link,
            and the messages.
        relayed: Messages that the coordinator had not passed on, by the tick in which they were sent.
        run_log: State of the run log, the digest included.
        reporter: State of the protocol's reporter; None without a protocol report.
        counts: Payloads of all sides: sent, delivered, lost, late.
        refused: Number of malformed payloads, by owner of the key and name of the error.
        counters: Counters of cells whose processes have left.
        recorded: Number of messages in the recording, by topic, of complete ticks.
        dead: Indices of dead cells.
        wall_s: Wall time of the complete ticks, s.
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
    links: dict[int, tuple[MessageBytes, ...]]
    relayed: dict[int, MessageBytes]
    run_log: bytes
    reporter: bytes | None
    counts: tuple[int, int, int, int]
    refused: dict[tuple[str, str], int]
    counters: dict[str, int]
    recorded: dict[str, int]
    dead: tuple[int, ...]
    wall_s: float
    resumed: tuple[int, ...]

    def all_counts(self) -> MessageCounters:
        """Return the message counters as the bus keeps them."""
        counts = MessageCounters(*self.counts)
        counts.refused.update(self.refused)
        counts.cell_counters.update(self.counters)
        return counts

    def to_bytes(self) -> bytes:
        """Encode the checkpoint as the content of a file."""
        body = encode({name: getattr(self, name) for name in _TYPES}, {})
        head = MAGIC + FORMAT.to_bytes(2, "little")
        return head + sha256(head + body).digest() + body

    @classmethod
    def from_bytes(cls, content: bytes) -> Checkpoint:
        """Decode a checkpoint from the content of a file.

        Raises:
            InputError: The content is cut, changed or of another format; the message says which.
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
    "links": (dict,),
    "relayed": (dict,),
    "run_log": (bytes,),
    "reporter": (bytes, type(None)),
    "counts": (tuple,),
    "refused": (dict,),
    "counters": (dict,),
    "recorded": (dict,),
    "dead": (tuple,),
    "wall_s": (float,),
    "resumed": (tuple,),
}
_ITEMS: Final[Mapping[str, tuple[type, type]]] = {
    "bound": (str, str),
    "states": (int, bytes),
    "links": (int, tuple),
    "relayed": (int, tuple),
    "refused": (tuple, int),
    "counters": (str, int),
    "recorded": (str, int),
}
"""Types of keys and values, of maps with one type each."""


def _check(values: Any) -> None:
    """Check the decoded fields of a checkpoint.

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
    for messages in (
        *found["relayed"].values(),
        *(one for links in found["links"].values() for one in links),
    ):
        if type(messages) is not tuple or list(map(type, cast("Any", messages))) != [bytes, bytes]:
            raise InputError("links, relayed: messages of a tick must be two bytes each")
    for name in ("counts", "dead", "resumed"):
        if any(type(number) is not int or number < 0 for number in found[name]):
            raise InputError(f"{name}: must be numbers from 0")
    if len(found["counts"]) != 4 or found["tick"] < 1:
        raise InputError("counts: must be four numbers; tick: must be at least 1")
