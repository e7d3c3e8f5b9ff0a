"""Carries packets between two network namespaces, as bad a link as is wanted: delay, loss, cuts."""

from __future__ import annotations

import heapq
import os
import random
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

ROOT = Path(__file__).resolve().parents[2]
PLANT, CELLS = "10.77.0.1", "10.77.0.2"
_MTU = 65_536


class Relay:
    """A link between two namespaces, each with one command in it.

    Args:
        delay_s: Each way.
        loss: Share of packets lost, each way.
        seed: Of the losses.

    Attributes:
        carried: Packets that came through.
        lost: Packets that were lost by chance.
        cut: Packets that were lost to cuts.
    """

    def __init__(self, delay_s: float, loss: float, seed: int) -> None:
        self._delay_s, self._loss = delay_s, loss
        self._draw = random.Random(f"relay {seed}")
        self._devices: list[int] = []
        self._processes: list[subprocess.Popen[str]] = []
        self._callers: list[socket.socket] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="relay", daemon=True)
        self._cut_until = 0.0
        self.carried = self.lost = self.cut = 0

    def start(self, own: str, peer: str, command: Sequence[str]) -> subprocess.Popen[str]:
        """Prepare a command in a namespace of its own; it begins with ``go``. Skips where that is not permitted."""
        ours, theirs = socket.socketpair()
        with theirs:
            process = subprocess.Popen(
                [sys.executable, "-m", "tests.system.inside", str(theirs.fileno()), own, peer, *command],
                cwd=ROOT,
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
        self._processes.append(process)
        self._callers.append(ours)
        word, devices, _, _ = socket.recv_fds(ours, 4096, 1)
        if not devices:
            pytest.skip(f"no network namespace: {word.decode() or 'the process ended'}")
        os.set_blocking(devices[0], False)
        self._devices += devices
        return process

    def go(self) -> None:
        """Begin to carry, and let both commands begin."""
        self._thread.start()
        for caller in self._callers:
            caller.send(b".")

    def cut_for(self, seconds: float) -> None:
        """Nothing comes through from now on."""
        self._cut_until = time.monotonic() + seconds

    def _carry(self) -> None:
        """Both ways, until closed: every packet is lost, or comes after the delay, in order."""
        one, other = self._devices
        to = {one: other, other: one}
        waiting: list[tuple[float, int, int, bytes]] = []
        number = 0
        while not self._over.is_set():
            left = waiting[0][0] - time.monotonic() if waiting else 0.05
            ready, _, _ = select.select([one, other], [], [], min(max(left, 0.0), 0.05))
            now = time.monotonic()
            try:
                for device in ready:
                    number += 1
                    heapq.heappush(waiting, (now + self._delay_s, number, to[device], os.read(device, _MTU)))
                while waiting and waiting[0][0] <= now:
                    _, _, device, packet = heapq.heappop(waiting)
                    self._pass_on(device, packet, now)
            except OSError:
                return  # a namespace goes with the last process in it

    def _pass_on(self, device: int, packet: bytes, now: float) -> None:
        if now < self._cut_until:
            self.cut += 1
        elif self._draw.random() < self._loss:
            self.lost += 1
        else:
            os.write(device, packet)
            self.carried += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            with process:
                if process.poll() is None:
                    os.killpg(process.pid, 9)
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        for caller in self._callers:
            caller.close()
        for device in self._devices:
            os.close(device)
