"""Writer of ``recording.mcap`` during a run, with regular flushes so that a crash loses little."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import DeployError, InputError
from deploy.recordings.format import (
    CONTROL,
    END,
    EVENTS,
    FAULTS,
    FILE_NAME,
    MESSAGES,
    PARCELS,
    REGISTERS,
    TICK,
    TRACE,
    Header,
)
from deploy.recordings.json_text import json_bytes, parcels_text
from deploy.recordings.mcap import McapFile
from deploy.util.files import sync_folder

FLUSH_S = 0.25
"""Wall time between two flushes; a crash loses this much and the time of one flush."""

CHUNK_BYTES = 256 * 1024
"""A chunk is compressed and written when it has grown to this, or at the flush."""

BACKLOG_BYTES = 64 * 1024 * 1024
"""More than this unwritten, and the run waits for the disk."""


@final
class Recorder:
    """Recorder of one run.

    The caller's methods only serialise and queue. A thread of the recorder does all that touches the file:
    it writes and flushes every ``flush_s`` of wall time, also while the run stands still, and never sees a
    signal, so that an interrupt at any moment leaves whole records. Only one thread may call the methods.
    An open recorder being a thread, never fork from its process.

    Used as a context manager, leaving it closes a recording that is still open, as ``interrupted`` after
    KeyboardInterrupt and as ``failed`` otherwise.

    Args:
        folder: Output folder, made with its parents where absent; a recording in it is replaced.
        header: Header of the recording.
        flush_s: Wall time between two flushes.
        continued_from: Number of messages to keep of the existing recording, by topic; None: a new recording.

    Attributes:
        path: The file.
        header: As given.

    Raises:
        InputError: The folder or the file can't be made or written.
        DeployError: From any method: the file can no longer be written (a full disk, say).
    """

    def __init__(
        self,
        folder: str | Path,
        header: Header,
        *,
        flush_s: float = FLUSH_S,
        continued_from: Mapping[str, int] | None = None,
    ) -> None:
        self.path: Path = Path(folder) / FILE_NAME
        self.header = header
        self._flush_s = flush_s
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._last: dict[str, bytes] = {}
            if continued_from is None:
                self._file = McapFile(self.path, header, CHUNK_BYTES)
            else:
                self._file = self._continued(header, continued_from)
        except OSError as error:
            with suppress(OSError):
                if self.path.is_file() and not self.path.stat().st_size:  # begun here, on a full disk
                    self.path.unlink()
            raise InputError(f"output {folder}: can't write {self.path.name} there: {_why(error)}") from error
        self._channels = self._file.channels
        self._counts = Counter(continued_from or {})
        self._ticks = 0
        self._time_ns = 0
        self._queue: deque[tuple[int, int, bytes]] = deque()
        self._queued = 0  # bytes, counted by the caller's thread
        self._written = 0  # bytes, counted by the recorder's thread
        self._flushed = 0
        self._closing = False
        self._ended = False
        self._error: DeployError | None = None
        self._wake = threading.Event()
        self._progress = threading.Condition()
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    @property
    def broken(self) -> bool:
        """Whether the file can no longer be written; every method raises then."""
        return self._error is not None

    def _continued(self, header: Header, continued_from: Mapping[str, int]) -> McapFile:
        """Replace the recording by a copy of its beginning; the old file stays until the copy is whole."""
        from deploy.recordings.truncate import copy_prefix

        draft = self.path.with_name(f".{self.path.name}.draft")
        file = McapFile(draft, header, CHUNK_BYTES)
        try:
            self._last = copy_prefix(self.path, file, continued_from)
            file.flush()  # a sync alone leaves the last chunk in this process
            file.sync()
            draft.replace(self.path)
            sync_folder(self.path.parent)
        except BaseException:
            file.abandon()
            draft.unlink(missing_ok=True)
            raise
        return file

    def tick(
        self,
        tick: int,
        time_ns: int,
        presence: NDArray[np.bool_],
        drives: NDArray[np.float64] | None,
        wheel_speeds: NDArray[np.float64],
        parcels: NDArray[np.float64],
    ) -> None:
        """Record the state at an instant and the drives acting from then on.

        Call it once per tick, before the plant advances, and a last time with ``drives=None`` when the run is
        over, so that the recording holds the final state too.

        Args:
            tick: Number of the tick, from 0; at the end the number of ticks.
            time_ns: Simulated time of the instant.
            presence: ``(n, sensors)`` bits sensed at the instant.
            drives: ``(n, 2)`` that act from the instant on, or None at the end of the run.
            wheel_speeds: ``(n, 2)`` surface speed of each wheel at the instant, m/s.
            parcels: ``(m, 6)`` states at the instant.
        """
        message: dict[str, Any] = {"tick": tick}
        self._add_changed(message, "presence", np.packbits(presence, bitorder="little").tobytes())
        self._add_wheel_speeds(message, wheel_speeds.astype("<f8", copy=False).tobytes())
        if drives is None:
            message["end"] = True
        else:
            self._add_changed(message, "drives", drives.astype("<f8", copy=False).tobytes())
        self._add_changed(message, "parcels", parcels.astype("<f8", copy=False).tobytes())
        self._ticks = tick
        self._time_ns = time_ns
        self._put(TICK, time_ns, self._file.pack(message))
        self._put(PARCELS, time_ns, parcels_text(tick, time_ns, parcels))

    def registers(self, tick: int, time_ns: int, registers: Mapping[str, NDArray[Any]]) -> None:
        """Record the cells' registers after a tick.

        Args:
            tick: Number of the tick.
            time_ns: Simulated time of its start, ns.
            registers: Registers of all cells by name, ``(n, ...)``; zero for dead cells.
        """
        self._put_arrays(REGISTERS, "registers", tick, time_ns, registers)

    def messages(self, tick: int, time_ns: int, messages: Mapping[str, NDArray[Any]]) -> None:
        """Record the messages that cells sent in a tick.

        Args:
            tick: The tick.
            time_ns: Its start.
            messages: ``sent`` ``(n, 4)``, and ``(n, 4)`` by name of the field; zero for dead cells.
        """
        self._put_arrays(MESSAGES, "messages", tick, time_ns, messages)

    def trace(self, tick: int, time_ns: int, trace: Mapping[str, NDArray[Any]]) -> None:
        """Record what the programs of traced cells read and sent in a tick.

        Args:
            tick: The tick.
            time_ns: Its start.
            trace: Result of ``deploy.recordings.message_trace.trace_of``.
        """
        self._put_arrays(TRACE, "trace", tick, time_ns, trace)

    def _put_arrays(
        self, topic: str, key: str, tick: int, time_ns: int, arrays: Mapping[str, NDArray[Any]]
    ) -> None:
        values = {
            name: [array.dtype.str, list(array.shape), array.tobytes()] for name, array in arrays.items()
        }
        self._put(topic, time_ns, self._file.pack({"tick": tick, key: values}))

    def event(self, event: Mapping[str, Any]) -> None:
        """Record an event of the plant: at least ``time_s`` and ``kind``."""
        self._put_json(EVENTS, event)

    def fault(self, fault: Mapping[str, Any]) -> None:
        """Record a fault, scheduled, live or found: at least ``time_s`` and ``kind``."""
        self._put_json(FAULTS, fault)

    def control(self, control: Mapping[str, Any]) -> None:
        """Record a live command at its effective time: at least ``time_s`` and ``kind``."""
        self._put_json(CONTROL, control)

    def flush(self) -> None:
        """Return when all that was recorded is in the file, safe from the death of this process."""
        target = self._queued
        self._wake.set()
        with self._progress:
            self._progress.wait_for(lambda: self._ended or self._flushed >= target)
        self._check()

    def position(self) -> tuple[dict[str, int], int]:
        """Return the number of messages by topic so far, and the mark for `sync_to` that covers them."""
        return dict(self._counts), self._queued

    def sync_to(self, mark: int) -> None:
        """Wait until the recording up to ``mark`` is on disk, safe from a power loss; callable from any thread.

        Raises:
            DeployError: The recorder ended before the mark was written.
        """
        self._wake.set()
        with self._progress:
            self._progress.wait_for(lambda: self._ended or self._flushed >= mark)
        if self._flushed < mark:
            raise DeployError(f"can't write the recording {self.path} up to the checkpoint")
        self._file.sync()

    def close(self, status: str, digest: str | None = None, motion_digest: str | None = None) -> None:
        """Write the end record and finish the file; a second call does nothing.

        Args:
            status: ``ok``, ``failed``, ``stalled``, ``unstable`` or ``interrupted``.
            digest: Digest of the run, in hexadecimal; None without one.
            motion_digest: Its motion digest; None without one.
        """
        if self._closing:
            return
        end = {
            "status": status,
            "ticks": self._ticks,
            "time_s": self._time_ns * 1e-9,
            "digest": digest,
            "motion_digest": motion_digest,
        }
        try:
            self._put(END, self._time_ns, json_bytes(end))
        finally:
            self._closing = True
            self._wake.set()
            self._thread.join()
        self._check()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or self._error is None:  # otherwise the file may be what broke, and it is closed
            self.close("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")

    # --- the caller's thread ---------------------------------------------------------------------

    def _add_changed(self, message: dict[str, Any], name: str, data: bytes) -> None:
        """Add a field to a message unless its value is unchanged; the loader repeats the previous value."""
        if self._last.get(name) != data:
            self._last[name] = message[name] = data

    def _add_wheel_speeds(self, message: dict[str, Any], data: bytes) -> None:
        """Add wheel speeds; of wheels that follow their drives at once, the drives recorded before stand for them."""
        before = self._last.get("drives")
        if before is not None and data == before and data != self._last.get("wheel_speeds"):
            self._last["wheel_speeds"], message["wheel_speeds"] = before, None
        else:
            self._add_changed(message, "wheel_speeds", data)

    def _put_json(self, topic: str, record: Mapping[str, Any]) -> None:
        self._put(topic, round(record["time_s"] * 1e9), json_bytes(record))

    def _put(self, topic: str, time_ns: int, data: bytes) -> None:
        self._counts[topic] += 1
        if self._ended:
            self._check()
            raise DeployError(f"this is a bug: {self.path} is closed and can't take more")
        # In this order an interrupt between the two lines leaves a flush too short, never one without end.
        self._queue.append((self._channels[topic], time_ns, data))
        self._queued += len(data)
        backlog = self._queued - self._written
        if backlog > CHUNK_BYTES:
            if not self._wake.is_set():  # the thread clears it before it looks at the queue
                self._wake.set()
            if backlog > BACKLOG_BYTES:
                with self._progress:
                    self._progress.wait_for(
                        lambda: self._ended or self._queued - self._written < BACKLOG_BYTES
                    )

    def _check(self) -> None:
        """Raise if the recorder's thread ended before a request."""
        if self._error is not None:
            raise self._error
        if self._ended and not self._closing:
            raise DeployError(f"this is a bug: the recorder of {self.path} ended unexpectedly")

    # --- the recorder's thread -------------------------------------------------------------------

    def _write(self) -> None:
        """Write and flush on the clock until closed; then finish the file."""
        try:
            while not self._closing:
                self._wake.wait(self._flush_s)
                self._wake.clear()
                self._drain()
            self._drain()
            self._file.finish()
        except OSError as error:
            self._file.abandon()
            self._error = DeployError(f"can't write the recording {self.path}: {_why(error)}")
        finally:
            with self._progress:
                self._ended = True
                self._progress.notify_all()

    def _drain(self) -> None:
        """Write what is queued and hand it to the operating system."""
        if not self._queue:
            return
        written = self._written
        while self._queue:
            channel, time_ns, data = self._queue.popleft()
            self._file.add(channel, time_ns, data)
            written += len(data)
        self._file.flush()
        with self._progress:
            self._written = self._flushed = written
            self._progress.notify_all()


def _why(error: OSError) -> str:
    return error.strerror or str(error)
