"""Hosts of a small network: network namespaces with an address each, on one switch."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

ROOT = Path(__file__).resolve().parents[2]
_NETWORK = "10.88.77"


class Hosts:
    """Hosts, by name; skips the test where namespaces are not permitted.

    The switch is a bridge in a namespace of its own: nothing of it is seen outside, and all goes with the namespaces.

    Args:
        names: Of the hosts, one letter each.
    """

    def __init__(self, names: str) -> None:
        self.address = {name: f"{_NETWORK}.{number}" for number, name in enumerate(names, 1)}
        self._processes: list[subprocess.Popen[str]] = []
        self._made: list[str] = []

    def __enter__(self) -> Self:
        if os.geteuid() != 0 or shutil.which("ip") is None:
            pytest.skip("network namespaces need the superuser and the command ip")
        try:
            self._make("switch")
            _ip("-n", _space("switch"), "link", "add", "bridge", "type", "bridge")
            _ip("-n", _space("switch"), "link", "set", "bridge", "up")
            for name, address in self.address.items():
                self._attach(name, address)
        except subprocess.CalledProcessError as error:
            self._remove()
            pytest.skip(f"no network namespaces: {error.stderr.strip()}")
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            with process:
                if process.poll() is None:
                    os.killpg(process.pid, 9)
        self._remove()

    def start(self, host: str, command: Sequence[object], **more: str) -> subprocess.Popen[str]:
        """Start a command on a host, in a session of its own; it is killed in the end at the latest."""
        process = subprocess.Popen(
            ["ip", "netns", "exec", _space(host), *map(str, command)],
            cwd=ROOT,
            env={**os.environ, **more},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._processes.append(process)
        return process

    def cut(self, host: str) -> None:
        """Pull a host's cable."""
        _ip("-n", _space("switch"), "link", "set", "dev", host, "down")

    def heal(self, host: str) -> None:
        """Plug it in again."""
        _ip("-n", _space("switch"), "link", "set", "dev", host, "up")

    def _make(self, name: str) -> None:
        _ip("netns", "add", _space(name))
        self._made.append(name)
        _ip("-n", _space(name), "link", "set", "lo", "up")

    def _attach(self, name: str, address: str) -> None:
        """Make a host, and its cable to the switch."""
        self._make(name)
        switch, host = _space("switch"), _space(name)
        _ip("-n", switch, "link", "add", "name", name, "type", "veth", "peer", "name", "cable", "netns", host)
        _ip("-n", switch, "link", "set", "dev", name, "master", "bridge", "up")
        _ip("-n", host, "addr", "add", f"{address}/24", "dev", "cable")
        _ip("-n", host, "link", "set", "cable", "up")

    def _remove(self) -> None:
        while self._made:
            subprocess.run(["ip", "netns", "del", _space(self._made.pop())], check=False, capture_output=True)


def _space(name: str) -> str:
    """Name of a namespace, of this process alone."""
    return f"mdms-{os.getpid()}-{name}"


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)
