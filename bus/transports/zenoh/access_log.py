"""Counters of denials: payloads and connections that Zenoh refuses in the plant's process.

Zenoh reports neither payloads that its access control denies nor connections that it rejects, except in its log. The
log goes to the process's standard output and can't be redirected. While an ``AccessLogMonitor`` is open, file
descriptor 1 is therefore a pipe that a thread reads; other output is passed on to the original destination.

Zenoh logs what it drops without the key. It does have a line with the key, but that one comes for every message
that may pass, too: at 18 processes 100,000 lines a second.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any, Final, cast, final

import zenoh

Denial = tuple[str, str]
"""Role or session, and what was refused."""

STRANGER: Final = "a stranger"
"""Stands for connections that were not admitted."""
DROPPED: Final = "message"
"""Anything that access control denies: a payload, a subscription, a token, a query."""
NO_ROLE: Final = "no role"
"""Stands for admitted sessions without permissions: the access control does not know their name."""

_FILTER: Final = ",".join(
    (
        "zenoh::net::routing::interceptor=trace",
        "zenoh::net::routing::interceptor::access_control=info",
        "zenoh::net::primitives::demux=trace",
        "zenoh_link_tls::unicast=warn",
        "zenoh_transport::unicast::establishment::accept=debug",
    )
)
_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
_ZENOH: Final = re.compile(rb"^\d{4}-\d\d-\d\dT\S+Z +(?:TRACE|DEBUG|INFO|WARN|ERROR) ")
_LINE: Final = re.compile(
    rb"src=[^ }]*client/(?P<dropped>[0-9a-f]+):\d+\}.* zenoh::net::routing::interceptor: Msg intercepted!"
    rb"|access_control: (?P<unknown>[0-9a-f]+) did not match any configured ACL subject"
    rb"|WARN .*zenoh_link_tls::unicast: (?P<tls>.+?)\.? Hint: "
    rb"|accept: UsrPwd extension - Recv \w+\. (?P<password>[^.]+)\."
)
_REASONS: Final = {
    "peer sent no certificates": "it has no certificate",
    "Expected extension": "it has no password",
    "Invalid user": "a user that is not in the file",
    "Invalid password": "a wrong password",
}
_MOST: Final = 1_000
"""Most denials counted separately, which bounds the memory that a stranger can fill."""

_PATIENCE_S: Final = 2.0

_logging = False


@final
class AccessLogMonitor:
    """Counter of denials by Zenoh in this process, over all sessions, until ``close``; one monitor at a time.

    Attributes:
        names: Lookups of a session's role by the beginning of its identifier, one for each session that listens.
        fresh: Whether a new kind of denial occurred since the last call of ``counted``.
    """

    def __init__(self) -> None:
        self.names: list[Callable[[str], str | None]] = []
        self.fresh = False
        self._names: dict[str, str] = {}
        self._counts: Counter[Denial] = Counter()
        self._lock = threading.Lock()
        self._asked = "RUST_LOG" in os.environ
        self._before = os.dup(1)
        reading, writing = os.pipe()
        self._reading = reading
        os.dup2(writing, 1)
        os.close(writing)
        self._reader = threading.Thread(target=self._read, name="refusals", daemon=True)
        self._reader.start()
        _log()

    def counted(self) -> dict[Denial, int]:
        """Return the number of each denial so far."""
        self.fresh = False
        with self._lock:
            return dict(self._counts)

    def close(self) -> None:
        """Read the rest of the log, and restore standard output."""
        if self._before < 0:
            return
        before, self._before = self._before, -1
        os.dup2(before, 1)  # the pipe's last writer: its reader comes to an end
        self._reader.join(_PATIENCE_S)
        if not self._reader.is_alive():  # else somebody has inherited the pipe
            os.close(self._reading)
            os.close(before)

    def _read(self) -> None:
        before, unread = self._before, b""
        while chunk := os.read(self._reading, 1 << 16):
            *lines, unread = (unread + chunk).split(b"\n")
            self._take(lines, before)
        if unread:
            self._take([unread], before)

    def _take(self, lines: list[bytes], before: int) -> None:
        found: Counter[Denial] = Counter()
        for line in lines:
            plain = _COLOUR.sub(b"", line) if b"\x1b" in line else line
            match = _LINE.search(plain)
            if match is not None:
                found[self._refusal(match)] += 1
            else:
                self._pass_on(line, before, of_zenoh=_ZENOH.match(plain) is not None)
        with self._lock:
            for refusal, number in found.items():
                known = refusal in self._counts
                if known or len(self._counts) < _MOST:
                    self._counts[refusal] += number
                    self.fresh = self.fresh or not known

    def _pass_on(self, line: bytes, before: int, *, of_zenoh: bool) -> None:
        """Pass on a line that is no denial; other Zenoh log lines go to standard error if ``RUST_LOG`` is set."""
        if of_zenoh and not self._asked:
            return
        with contextlib.suppress(OSError):  # whoever listened there has gone
            os.write(2 if of_zenoh else before, line + b"\n")

    def _refusal(self, match: re.Match[bytes]) -> Denial:
        what, text = str(match.lastgroup), match[str(match.lastgroup)].decode(errors="replace")
        if what in ("dropped", "unknown"):
            return self._named(text), DROPPED if what == "dropped" else NO_ROLE
        reason = _REASONS.get(text, text)
        return STRANGER, f"connection: {reason}"

    def _named(self, session: str) -> str:
        """Return the role of a session; looked up once, at the first denial, while the session is connected."""
        found = self._names.get(session)
        if found is None:
            known = (name for look_up in list(self.names) if (name := look_up(session)))
            found = next(known, f"session {session[:8]}")
            if len(self._names) < _MOST:
                self._names[session] = found
        return found


def _log() -> None:
    """Enable the log lines to count; once a process, and irrevocable."""
    global _logging  # noqa: PLW0603 - one process, one log
    if _logging:
        return
    _logging = True
    own = os.environ.get("RUST_LOG")
    os.environ["RUST_LOG"] = f"{_FILTER},{own}" if own else _FILTER
    cast("Any", zenoh).try_init_log_from_env()
    if own is None:
        del os.environ["RUST_LOG"]
    else:
        os.environ["RUST_LOG"] = own
