"""What somebody with a cell's keys does to a run who puts as fast as they can.

``python tests/benchmarks/bus/keys_flood.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, cast

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import msgpack
from keys_case import ROOT, Run, keys_for, write_scene

from bus.wire.msgpack_codec import VERSION

METHOD = """\
Method. heat_diffusion on 3 x 6 cells in 2 processes with certificates, {ticks} ticks by mdms run; beside it a process
with the keys of the first that puts for {seconds:g} s as fast as Zenoh takes it. MB: the most memory that the plant's
process had. All should come to the same digest.
"""
KINDS = {
    "none": "nobody",
    "idle": "somebody who computes on the same machine and puts nothing",
    "denied": "1 byte on another's drive",
    "garbage": "100 bytes that are no payload, on its own drive",
    "late": "drives of a tick that is over, on its own key",
    "huge": "8 MB on its own drive",
    "giant": "200 MB on its own drive",
}
LATE = msgpack.packb({"v": VERSION, "tick": 0, "drive": bytes(144)})
PAYLOADS = {
    "denied": b"x",
    "garbage": b"\xc1" * 100,
    "late": LATE,
    "huge": bytes(8_000_000),
    "giant": bytes(200_000_000),
}
NOT_REFUSED = ("sent", "delivered", "protocol")
AFTER_TICKS = 20
"""Ticks that the flood lets pass first: what comes for them is late for certain."""
DRAIN_S = 2.0


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ticks", type=int, default=2_000)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--kind", choices=list(KINDS), action="append", help="only this one")
    parser.add_argument("--flood", nargs=3, metavar=("KIND", "ENDPOINT", "KEYS"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.flood:
        kind, endpoint, keys = given.flood
        flood(kind, endpoint, Path(keys), given.seconds)
        return
    print(METHOD.format(ticks=given.ticks, seconds=given.seconds))
    with tempfile.TemporaryDirectory() as folder:
        scene = write_scene(Path(folder))
        keys = keys_for(scene, 2, Path(folder) / "keys", "certificate")
        for kind in given.kind or KINDS:
            print(
                f"{kind:8} {KINDS[kind]}\n         {measure(kind, scene, keys, given.ticks, given.seconds)}",
                flush=True,
            )


def measure(kind: str, scene: Path, keys: Path, ticks: int, seconds: float) -> str:
    """One run and one flood: what came of them."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        join = f"tls/127.0.0.1:{probe.getsockname()[1]}"
    run = Run(scene, 2, keys, scene.parent / "out", join)
    with subprocess.Popen(run.command(ticks), stdout=subprocess.PIPE, text=True, cwd=ROOT) as running:
        flooding: subprocess.Popen[str] | None = None
        if kind != "none":
            command = [
                sys.executable,
                __file__,
                "--seconds",
                str(seconds),
                "--flood",
                kind,
                join,
                str(keys),
            ]
            flooding = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        most_kb = 0
        while running.poll() is None:
            most_kb = max(most_kb, memory_kb(running.pid))
            time.sleep(0.05)
        assert running.stdout is not None
        summary = json.loads(running.stdout.read())
    put = "" if flooding is None else f"put {int(flooding.communicate()[0]):,}; "
    return put + told(summary, most_kb)


def told(summary: dict[str, Any], most_kb: int) -> str:
    """In a line."""
    messages = {name: n for name, n in summary["messages"].items() if name not in NOT_REFUSED and n}
    counts = ", ".join(f"{n:,} {name}" for name, n in messages.items()) or "nothing refused"
    return (
        f"{summary['status']}, {summary['ticks_per_s']:,.0f} ticks/s, {most_kb / 1024:,.0f} MB; {counts}; "
        f"{len(summary['cells_lost'])} cells lost; digest {summary['digest'][:8]}"
    )


def flood(kind: str, endpoint: str, keys: Path, seconds: float) -> None:
    """Somebody with the first process's keys."""
    import zenoh

    from bus.transports.zenoh import client_config
    from deploy.security.keyring import identity_of

    session = cast("Any", zenoh).open(
        client_config(endpoint, timeout_s=20.0, identity=identity_of(keys / "cells-0", "cells-0"))
    )
    senses = session.declare_subscriber("mdms/*/shard/0/sense")
    for _ in range(AFTER_TICKS):
        run = str(senses.recv().key_expr).split("/")[1]
    senses.undeclare()
    key = f"mdms/{run}/shard/{1 if kind == 'denied' else 0}/drive"
    count, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        if kind != "idle":
            session.put(key, PAYLOADS[kind], congestion_control=zenoh.CongestionControl.BLOCK)
            count += 1
    time.sleep(DRAIN_S)
    print(count)
    session.close()


def memory_kb(pid: int) -> int:
    """What a process has in memory; 0 where it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("VmRSS")), 0)


if __name__ == "__main__":
    main()
