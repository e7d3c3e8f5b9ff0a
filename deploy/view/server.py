"""Server of the page, on a loopback address."""

# pyright: reportUnknownMemberType=false
# (Bokeh leaves some of its methods untyped.)

from __future__ import annotations

import logging
import os
import socket
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final, final

from deploy.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from bokeh.document import Document
    from bokeh.server.server import Server

    from deploy.view.source import RunSource

LOOPBACK: Final = "127.0.0.1"
_POLL_MS: Final = 40
"""Interval at which what a run has sent is taken, wall milliseconds."""
_KEEP_MS: Final = 5_000
"""Time after which the session of a browser that left is dropped, wall milliseconds."""


def check_port(port: int) -> None:
    """Check that a page can be served at a port, before anything is started for the page.

    Raises:
        InputError: The port can't be used.
    """
    with socket.socket() as probe:
        probe.setsockopt(
            socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
        )  # as the server does: not against ends of old pages
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror}") from None


@final
class PageServer:
    """Server of a source's page; its files come from this machine, none from a network.

    Args:
        source: The run.
        port: TCP port; 0: a free one.
        on_open: Called once, in another thread, when a browser opens the page for the first time.

    Attributes:
        url: Address of the page.

    Raises:
        InputError: The port can't be used.
    """

    def __init__(self, source: RunSource, port: int = 0, on_open: Callable[[], None] | None = None) -> None:
        logging.getLogger("bokeh.server.views.ws").setLevel(logging.ERROR)  # browsers may leave at any time
        os.environ["BOKEH_RESOURCES"] = "server"  # a person's own setting could name a host of files
        from bokeh.server.server import Server
        from tornado.ioloop import IOLoop, PeriodicCallback

        self._source = source
        self._on_open = on_open
        self._executor = ThreadPoolExecutor(1, "mdms-view-requests")
        self._loop = IOLoop()
        try:
            self._server: Server = Server(
                self._page,
                io_loop=self._loop,
                address=LOOPBACK,
                port=port,
                allow_websocket_origin=[f"{LOOPBACK}:{port}"] if port else None,
                unused_session_lifetime_milliseconds=_KEEP_MS,
                check_unused_sessions_milliseconds=_KEEP_MS // 2,
                keep_alive_milliseconds=10_000,
            )
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror or error}") from None
        self.url = f"http://{LOOPBACK}:{self._server.port}/"
        self._poll = PeriodicCallback(source.poll, _POLL_MS)

    def _page(self, document: Document) -> None:
        from deploy.view.page import build_page

        build_page(document, self._source, self._executor)
        if self._on_open is not None:
            self._executor.submit(self._on_open)
            self._on_open = None

    def run(self) -> None:
        """Serve until `stop`."""
        self._server.start()
        self._poll.start()
        try:
            self._loop.start()
        finally:
            self._poll.stop()
            self._server.stop()
            self._executor.shutdown(wait=False, cancel_futures=True)
            self._source.close()
            self._loop.close(all_fds=True)

    def stop(self) -> None:
        """End `run`; may be called from another thread or a signal handler."""
        self._loop.add_callback(self._loop.stop)
