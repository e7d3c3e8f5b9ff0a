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
        kind: What was being read or written (``"sense"``, ``"drive"``, ``"link"``, ...).
        reason: The broken rule, from a small fixed vocabulary, so that it can be counted by name.
        detail: What was found and what is allowed.
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
    """A cut of the lattice that isn't one: a cell in no shard or in two."""


@final
class TransportError(BusError):
    """A transport could not do what was asked: a port in use, nobody listening, a forked session."""


@final
class BarrierError(BusError):
    """The run could not start: somebody expected was not there, or not ready, in time.

    Attributes:
        absent: ``(row, column)`` of cells whose token never appeared, or appeared and went again.
        unready: ``(row, column)`` of cells that appeared but never said they were ready.
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
    """The plant's process went away, or stayed silent for too long; raised on the cells' side."""


@final
class WaitInterrupted(BusError):
    """``Endpoint.wake`` was called while the lockstep waited: whoever called it knows why."""


@final
class StateError(BusError):
    """State that can't be saved or restored; names the attribute and the problem."""
