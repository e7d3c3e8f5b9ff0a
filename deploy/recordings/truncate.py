"""The beginning of a recording, copied: what a resumed run goes on from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

from deploy.errors import InputError
from deploy.recordings.format import PROFILE, TICK
from deploy.recordings.mcap import McapFile
from deploy.util.formatting import plural


def copy_prefix(path: Path, file: McapFile, counts: Mapping[str, int]) -> dict[str, bytes]:
    """Copy the first messages of every topic of a recording, whole or cut.

    Args:
        path: The recording.
        file: What they are added to.
        counts: How many, by topic; of topics that are not named, none.

    Returns:
        What each field of ``/tick`` is after the last of them.

    Raises:
        InputError: The recording holds fewer, is none, or is corrupt.
    """
    import msgpack  # pyright: ignore[reportMissingTypeStubs]

    from deploy.recordings.mcap_reader import Message, scan

    unpack = cast(Callable[[bytes], dict[str, Any]], msgpack.unpackb)  # pyright: ignore[reportUnknownMemberType]
    left, last = Counter(counts), dict[str, bytes]()
    try:
        for record in scan(path, PROFILE):
            if isinstance(record, Message) and left[record.topic] > 0:
                left[record.topic] -= 1
                file.add(file.channels[record.topic], record.time_ns, record.data)
                if record.topic == TICK:
                    fields = unpack(record.data)
                    if "drives" in last and fields.get("wheel_speeds", b"") is None:
                        last["wheel_speeds"] = last["drives"]
                    last |= {name: value for name, value in fields.items() if isinstance(value, bytes)}
    except FileNotFoundError:
        raise InputError(f"there is no {path.name} in {path.parent} to resume") from None
    missing = {topic: number for topic, number in left.items() if number > 0}
    if missing:
        listed = ", ".join(f"{plural(number, 'message')} of {topic}" for topic, number in missing.items())
        raise InputError(f"{path} ends before the checkpoint: {listed} are missing")
    return last
