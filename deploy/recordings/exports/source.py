"""Part of ``deploy.recordings.recording.Recording`` that exports need; avoids a circular import."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

if TYPE_CHECKING:
    import numpy as np

    from deploy.recordings.format import Header
    from plant.analysis.tractions import ArrayTractions


class Changing(Protocol):
    """A value that changes from instant to instant."""

    def at(self, instant: int) -> NDArray[Any]:
        """Return the value at one instant."""
        ...

    def all(self) -> NDArray[Any]:
        """Return the values at every instant."""
        ...


class RecordingSource(Protocol):
    """A recording in memory; see ``deploy.recordings.recording.Recording``."""

    @property
    def path(self) -> Path: ...  # noqa: D102
    @property
    def header(self) -> Header: ...  # noqa: D102
    @property
    def tick(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def time_ns(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def time_s(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def parcels(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def held_presence(self) -> Changing: ...  # noqa: D102
    @property
    def held_drives(self) -> Changing: ...  # noqa: D102
    @property
    def held_wheel_speeds(self) -> Changing: ...  # noqa: D102
    @property
    def register_tick(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def registers(self) -> dict[str, NDArray[Any]]: ...  # noqa: D102
    @property
    def message_tick(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def messages(self) -> dict[str, NDArray[Any]]: ...  # noqa: D102
    @property
    def trace_tick(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def trace(self) -> dict[str, NDArray[Any]]: ...  # noqa: D102
    @property
    def events(self) -> Sequence[dict[str, Any]]: ...  # noqa: D102
    @property
    def faults(self) -> Sequence[dict[str, Any]]: ...  # noqa: D102
    @property
    def control(self) -> Sequence[dict[str, Any]]: ...  # noqa: D102
    @property
    def status(self) -> str | None: ...  # noqa: D102
    @property
    def digest(self) -> str | None: ...  # noqa: D102
    @property
    def motion_digest(self) -> str | None: ...  # noqa: D102

    def tractions(self, instant: int) -> ArrayTractions:
        """Compute loads, slips and tractions at one instant."""
        ...
