"""Reporter that observes a protocol through a run and reports at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.lockstep.registers import RegisterRequest, RegisterSnapshot
from bus.state import StateFields
from cell_firmware.errors import FirmwareError
from deploy.protocol_report.report import (
    ProtocolReport,
    dominant_residual,
    excluded_effects,
    link_load,
    ratio,
    residual_history,
    verdict,
)
from deploy.protocol_report.residuals import CHANGE, Rate, Residuals, Snapshots, fit_rate

if TYPE_CHECKING:
    from bus.lattice import Lattice
    from cell_firmware.firmware import Firmware
    from cell_firmware.program import Theory
    from deploy.scenes.scene import Scene

DRIVE: Final = "drive"
_PROGRAM: Final = "firmware."


@final
class Reporter:
    """Collects a protocol's field tick by tick, in memory that doesn't grow with array size times run length.

    Args:
        scene: What runs.
        lattice: Its cells.
        every: Ticks from one sample to the next.

    Attributes:
        scene: Likewise.
        lattice: Likewise.
        observed: The program's variable that is its field; ``drive`` where it names none.
        theory: What theory says; None if nothing.
        deaths: Of every cell that died, in which tick; known once there is a report.
        residuals: Of the field.
        snapshots: Of the field.

    Raises:
        FirmwareError: The firmware raised in its theory.
    """

    state_fields: ClassVar[StateFields] = StateFields("notes", "_limit", "residuals", "snapshots")

    def __init__(self, scene: Scene, lattice: Lattice, every: int = 1) -> None:
        from cell_firmware.loader import load

        self.scene = scene
        self.lattice = lattice
        self.notes: list[str] = []
        firmware = load(scene.cells)
        self._message = firmware.message
        self._every = every
        self.observed = DRIVE if firmware.observable is None else firmware.observable
        if firmware.observable is None:
            self.notes.append("the program declares no field (observable): its drives are shown")
        self.theory = self._theory(firmware)
        limit = None if self.theory is None or self.theory.limit is None else _rows(self.theory.limit)
        if limit is not None and len(limit) != len(lattice):
            self.notes.append(f"theory's limit has {len(limit)} rows, not one a cell: left out")
            limit = None
        self._limit = limit
        self.deaths: Mapping[tuple[int, int], int] = {}
        self.residuals = Residuals(limit)
        self.snapshots = Snapshots()

    @property
    def wanted(self) -> tuple[RegisterRequest, ...]:
        """The registers to have the cells show."""
        return () if self.observed == DRIVE else (RegisterRequest(self._every, frozenset({self.register})),)

    @property
    def register(self) -> str:
        """The register that is the field, where the program names one."""
        return _PROGRAM + self.observed

    def take(self, shown: RegisterSnapshot) -> None:
        """Take what the cells showed of themselves in a tick."""
        field = shown.registers.get(self.register)
        if field is not None and shown.tick % self._every == 0:
            self._take(shown.tick, field, shown.cells)

    def take_drive(self, tick: int, drive: NDArray[np.float64], live: NDArray[np.bool_]) -> None:
        """Take what the cells drove in a tick, where that is observed."""
        if self.observed == DRIVE and tick % self._every == 0:
            self._take(tick, drive.copy(), live)

    def report(
        self, ticks: int, dead: Mapping[tuple[int, int], int], counters: Mapping[str, int] | None
    ) -> ProtocolReport:
        """Build the report of the protocol.

        Args:
            ticks: Number of ticks of the run.
            dead: Tick of death of every dead cell.
            counters: Counters of the cells; None if unknown.
        """
        self.deaths = dead
        residuals, theory = self.residuals, self.theory
        if not len(residuals.tick) and ticks:
            self.notes.append(f"no cell published {self.observed}: it is not a number, or has too many")
        histories = {
            name: found
            for name, rms in residuals.rms.items()
            if (found := residual_history(residuals.tick, rms, residuals.most[name])) is not None
        }
        rate_of, rate = self._dominant_rate(ticks, dead)
        predicted = None if theory is None else theory.factor
        return ProtocolReport(
            observed=self.observed,
            every_ticks=self._every,
            ticks=len(residuals.tick),
            cells=len(self.lattice),
            cells_dead=len(dead),
            law=None if theory is None else theory.law,
            predicted_factor=predicted,
            predicted_ticks=None if theory is None else theory.ticks,
            residuals=histories,
            rate_of=None if rate is None else rate_of,
            rate=rate,
            rate_ratio=ratio(rate, predicted),
            last_change_tick=residuals.moved,
            verdict=verdict(
                theory,
                residuals,
                rate,
                excluded_effects(self.scene, len(dead)),
                max(dead.values(), default=0),
            ),
            notes=tuple(self.notes),
            links=None
            if counters is None
            else link_load(self.scene, self._message, counters, *self._lived(ticks, dead)),
        )

    def _dominant_rate(self, ticks: int, dead: Mapping[tuple[int, int], int]) -> tuple[str, Rate | None]:
        """The dominant residual, and its rate."""
        name = dominant_residual(self.residuals)
        if self.theory is not None and self.theory.ticks is not None:
            return name, None  # it is done at once, not ever closer
        rate = self._rate(name, 0, min(dead.values(), default=ticks))
        if rate is None and dead:  # the limit is not what it was, but what comes to rest does so at some rate
            return CHANGE, self._rate(CHANGE, max(dead.values()), ticks)
        return name, rate

    def _rate(self, name: str, first: int, end: int) -> Rate | None:
        """The rate of a residual from a tick on, up to another."""
        tick = np.array(self.residuals.tick)
        part = (tick >= first) & (tick < end)
        rms, scale = np.array(self.residuals.rms[name]), np.array(self.residuals.scale)
        return fit_rate(tick[part], rms[part], scale[part])

    def _take(self, tick: int, field: NDArray[Any], live: NDArray[np.bool_]) -> None:
        rows = _rows(field)
        if self._limit is not None and self._limit.shape != rows.shape:
            self.notes.append(
                f"theory's limit has {self._limit.shape[1]} numbers a cell, the field {rows.shape[1]}"
            )
            self._limit, self.residuals = None, Residuals(None)
        change = self.residuals.take(tick, rows, live)
        self.snapshots.take(tick, change, rows, live)

    def _lived(self, ticks: int, dead: Mapping[tuple[int, int], int]) -> tuple[int, int]:
        """Ticks of all cells in which they lived, and of all directions of links whose sender did."""
        links = (self.lattice.neighbours >= 0).sum(axis=1)
        missed = {self.lattice.index(cell): max(ticks - tick, 0) for cell, tick in dead.items()}
        lost = sum(int(links[cell]) * gone for cell, gone in missed.items())
        return len(self.lattice) * ticks - sum(missed.values()), int(links.sum()) * ticks - lost

    def _theory(self, firmware: Firmware) -> Theory | None:
        try:
            return firmware.theory(self.lattice)
        except FirmwareError as error:
            if not isinstance(error.__cause__, ModuleNotFoundError):
                raise
            self.notes.append(f"theory needs {error.__cause__.name}, which is not installed")
            return None


def deaths_of(faults: Sequence[Mapping[str, Any]]) -> dict[tuple[int, int], int]:
    """Return the tick of every permanently dead cell, from a run's fault records."""
    return {
        (fault["cell"][0], fault["cell"][1]): int(fault["tick"]) for fault in faults if "phase" not in fault
    }


def _rows(field: NDArray[Any]) -> NDArray[np.float64]:
    """``(n, d)`` numbers of a field, whatever a cell's row of it is."""
    return np.asarray(field, dtype=np.float64).reshape(len(field), -1)
