"""Errors of the bus: one root, one class for each way it can go wrong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final


class BusError(Exception):
    """Root of every error the bus raises on purpose."""


@final
class WireError(BusError):
    """A payload in violation of its key's format.

    Args:
        kind: Kind of the payload (``"sense"``, ``"drive"``, ``"link"``, ...).
        reason: The violated rule, from a small fixed vocabulary, so that errors can be counted by name.
        detail: The value found, and what is allowed.
    """

    def __init__(self, kind: str, reason: str, detail: str) -> None:
        super().__init__(f"{kind} payload: {reason}: {detail}")
        self.kind = kind
        self.reason = reason

    @property
    def name(self) -> str:
        """The name under which this error is counted."""
        return f"{self.kind}: {self.reason}"


@final
class RunNameError(BusError):
    """A name that can't be part of a key expression."""


@final
class PartitionError(BusError):
    """An invalid partition of the lattice: a cell in no shard or in two."""


class TransportError(BusError):
    """A failed operation of a transport: a port in use, no listener, a forked session."""


@final
class BarrierError(BusError):
    """The run could not start: expected cells were not alive, or not ready, in time.

    Attributes:
        absent: ``(row, column)`` of cells whose token never appeared, or disappeared again.
        unready: ``(row, column)`` of cells that appeared but never became ready.
    """

    def __init__(
        self,
        message: str,
        *,
        absent: Sequence[tuple[int, int]] = (),
        unready: Sequence[tuple[int, int]] = (),
    ) -> None:
        super().__init__(message)
        self.absent = tuple(absent)
        self.unready = tuple(unready)


@final
class CoordinatorLostError(BusError):
    """The plant's process ended, or was silent for too long; raised on the cells' side."""


@final
class WaitInterrupted(BusError):
    """``Endpoint.wake`` was called while the lockstep waited; the caller of ``wake`` knows the reason.

    Attributes:
        wakeups: Number of calls of ``wake`` that ended the wait.
    """

    def __init__(self, problem: str, wakeups: int = 1) -> None:
        super().__init__(problem)
        self.wakeups = wakeups


@final
class StateError(BusError):
    """State that can't be saved or restored; names the attribute and the problem."""
