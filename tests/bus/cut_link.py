"""A link that can be cut: what is put in at one end comes out at the other, later where it was cut meanwhile."""

from __future__ import annotations

import socket
import threading
from types import TracebackType
from typing import Self


class CutLink:
    """Passes TCP connections on to an endpoint, but for the time that it is cut: then all waits.

    Args:
        to: Endpoint such as ``tcp/127.0.0.1:7447``.

    Attributes:
        locator: Where it listens itself.
    """

    def __init__(self, to: str) -> None:
        host, _, port = to.removeprefix("tcp/").rpartition(":")
        self._to = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.locator = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._whole = threading.Event()
        self._whole.set()
        self._sockets: list[socket.socket] = [self._listener]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut_for(self, seconds: float) -> None:
        """Nothing comes through from now on."""
        self._whole.clear()
        timer = threading.Timer(seconds, self._whole.set)
        timer.daemon = True
        timer.start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            far = socket.create_connection(self._to)
            self._sockets += [near, far]
            for one, other in ((near, far), (far, near)):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._pump, args=(one, other), daemon=True).start()

    def _pump(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while data := one.recv(65_536):
                self._whole.wait()
                other.sendall(data)
        except OSError:
            pass
        finally:
            other.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._whole.set()
        for one in self._sockets:
            one.close()
