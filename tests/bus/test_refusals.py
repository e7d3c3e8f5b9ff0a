"""What Zenoh refuses is read from its log, and nothing else that goes to standard output is lost or added to."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
WATCH = """
import json, os, sys
from bus.transports.zenoh.access_log import AccessLogMonitor
watch = AccessLogMonitor()
watch.names = [{}.get, {"ab12": "cells-0"}.get]
os.write(1, sys.stdin.buffer.read())
print("between", flush=True)
watch.close()
counted = [[*refusal, number] for refusal, number in watch.counted().items()]
print(json.dumps([counted, os.environ.get("RUST_LOG")]))
"""
DROPPED = (
    "2026-01-01T00:00:00.000001Z TRACE  rx-1 ThreadId(10) demux{zid=fe src=south:0:client/ab12:1}: "
    "zenoh::net::routing::interceptor: Msg intercepted!\n"
)
COLOURED = (
    "\x1b[2m2026-01-01T00:00:00.000001Z\x1b[0m \x1b[33m WARN\x1b[0m acc-0 ThreadId(05) \x1b[2mzenoh_link_tls::unicast"
    "\x1b[0m\x1b[2m:\x1b[0m peer sent no certificates. Hint: increase the system open file limit.\n"
)


def watched(text: str, **environment: str) -> tuple[dict[tuple[str, str], int], list[str], Any, str]:
    done = subprocess.run(
        [sys.executable, "-c", WATCH],
        input=text,
        cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": ":".join(sys.path), **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    *passed, last = done.stdout.splitlines()
    counted, log = json.loads(last)
    return {(whose, what): number for whose, what, number in counted}, passed, log, done.stderr


def test_refusals_are_counted_by_role_and_all_else_goes_where_it_went() -> None:
    strange = COLOURED.replace("sent no certificates", "\x1b[31msays no. 17")
    other = DROPPED.replace("ab12", "0123456789")
    elsewhere = DROPPED.replace("Msg intercepted!", "something else")
    counts, passed, log, stderr = watched(
        f"mine\n{DROPPED}{DROPPED}{COLOURED}{strange}{other}{elsewhere}no end"
    )
    assert counts == {
        ("cells-0", "message"): 2,
        ("a stranger", "connection: it has no certificate"): 1,
        ("a stranger", "connection: peer says no. 17"): 1,
        ("session 01234567", "message"): 1,
    }
    assert passed == ["mine", "no endbetween"]
    assert (log, stderr) == (None, "")


def test_a_stranger_can_t_make_the_list_longer_without_end_and_what_a_user_asks_for_is_shown() -> None:
    many = "".join(COLOURED.replace("no certificates", f"{i} certificates") for i in range(3_000))
    other = DROPPED.replace("Msg intercepted!", "something else")
    counts, passed, log, stderr = watched(many + other, RUST_LOG="warn")
    assert (len(counts), set(counts.values())) == (1_000, {1})
    assert (passed, log, stderr) == (["between"], "warn", other)
