"""Reset of SO_LINGER on TCP links of a listening session.

Zenoh sets SO_LINGER to 10 s on every TCP link, and TLS links alike. If the peer takes nothing any more, since its
process is stopped or the network is cut, then closing the link blocks one of Zenoh's threads for that time, and every
link that this thread serves. All sessions of a process share these threads (eclipse-zenoh/zenoh #1101 and #2350). Zenoh
has no setting for the option.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import struct
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Final, final

_OFF: Final = struct.pack("ii", 0, 0)
_EVERY_S: Final = 0.5
"""Interval of the sweeps, wall seconds: shorter than any lease."""
_SHARE: Final = 0.02
"""Longest share of the time that sweeps may take; with thousands of links they are further apart."""
_FOLDER: Final = "/dev/fd"
"""This process's open files, on Linux and macOS."""


@final
class LingerReset:
    """Reset of SO_LINGER on all present and future links to some ports of this process, until ``close``.

    Args:
        ports: Local TCP ports of the links.
    """

    def __init__(self, ports: Iterable[int]) -> None:
        self._ports = frozenset(ports)
        self._known: set[tuple[int, int]] = set()
        """Descriptor and inode of open files that have been looked at."""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="linger", daemon=True)
        if self._ports:
            self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._closed.set()

    def sweep(self) -> int:
        """Reset the option on links that are new since the last sweep; return their number."""
        found = 0
        seen: set[tuple[int, int]] = set()
        for path in Path(_FOLDER).iterdir():
            with contextlib.suppress(OSError, ValueError):  # closed meanwhile
                descriptor = int(path.name)
                status = os.fstat(descriptor)
                one = (descriptor, status.st_ino)
                seen.add(one)
                if one not in self._known and stat.S_ISSOCK(status.st_mode):
                    found += self._reset(descriptor)
        self._known = seen
        return found

    def _reset(self, descriptor: int) -> bool:
        """Reset the option if this is such a link."""
        # A duplicate: the descriptor itself may be closed, and mean another file, at any time.
        duplicate = os.dup(descriptor)
        try:
            link = socket.socket(fileno=duplicate)
        except OSError:
            os.close(duplicate)
            return False
        with link:
            if link.family not in (socket.AF_INET, socket.AF_INET6) or link.type != socket.SOCK_STREAM:
                return False
            if link.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                return False
            if link.getsockname()[1] not in self._ports:
                return False
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            return True

    def _work(self) -> None:
        pause_s = 0.0
        while not self._closed.wait(pause_s):
            begun = time.monotonic()
            self.sweep()
            pause_s = max(_EVERY_S, (time.monotonic() - begun) / _SHARE)


def tcp_ports(addresses: Iterable[str]) -> set[int]:
    """Return the TCP ports among a session's addresses, such as ``tcp/127.0.0.1:7447`` and ``tls/[::1]:7448``."""
    found: set[int] = set()
    for address in addresses:
        protocol, _, rest = address.partition("/")
        port = rest.partition("#")[0].partition("?")[0].rpartition(":")[2]
        if protocol in ("tcp", "tls", "ws") and port.isdecimal():
            found.add(int(port))
    return found
