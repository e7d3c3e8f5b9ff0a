"""Somebody who listens to everything that a run says, with plain Zenoh: python -m tests.system.listener ENDPOINT HOW

HOW is ``reads``, ``never`` (subscribes and never reads) or ``stops`` (its process is stopped after the first message).
Prints a line when the first message is there; one that reads prints a line of JSON at the end of its input: by key how
many messages came, and the ticks of the first and the last.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from typing import Any, cast

import msgpack
import zenoh


def plain_client(connect: str) -> zenoh.Session:
    """As docs/bus.md has it."""
    config = cast("Any", zenoh.Config())
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([connect]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def main(connect: str, how: str) -> None:
    session = plain_client(connect)
    if how != "reads":
        stuck = session.declare_subscriber("mdms/**", zenoh.handlers.FifoChannel(1))
        first = cast("Any", stuck).recv()
        print(first.key_expr, flush=True)
        if how == "stops":
            os.kill(os.getpid(), signal.SIGSTOP)
        sys.stdin.read()
        os._exit(0)
    heard: dict[str, list[int]] = {}
    begun = threading.Event()

    def take(sample: zenoh.Sample) -> None:
        tick = msgpack.unpackb(sample.payload.to_bytes())["tick"]
        row = heard.setdefault(str(sample.key_expr), [0, tick, tick])
        row[0] += 1
        row[2] = tick
        begun.set()

    subscriber = session.declare_subscriber("mdms/**", take)
    begun.wait()
    print("hears", flush=True)
    sys.stdin.read()
    cast("Any", subscriber).undeclare()
    print(json.dumps(heard), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
