"""Laboratory for neighbour protocols: cells in lockstep in this process, without a system around them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Self, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import Lattice
from cell_firmware.array_view import ArrayView, Violation
from cell_firmware.errors import FirmwareError
from cell_firmware.invariants import InvariantMonitor, declares_invariants
from cell_firmware.loader import load
from deploy.errors import InputError
from deploy.lab.cells import CellsAlone, CellsOnPlant, LabCells
from deploy.lab.faults import fault_tables, in_seconds, write_scene
from deploy.lab.injection import FaultInjection
from deploy.lab.tables import CellName, MessageSlots, Registers, States
from deploy.runs.checking import InvariantBroken
from deploy.scenes.fault_schedule import disturbs
from deploy.scenes.files import load_scene
from deploy.util.notebook import facts_html

if TYPE_CHECKING:
    from bus.lockstep.counters import Loss
    from deploy.scenes.scene import Scene

Cells = tuple[int, int] | Lattice | Iterable[CellName]
PresenceSchedule = NDArray[np.bool_] | Mapping[int, Iterable[CellName]] | Callable[["Lab"], NDArray[np.bool_]]
Check = Literal["stop", "count"] | None

_LONG_S: Final = 1e9
"""Duration of a lab's scene."""


@final
@dataclass(frozen=True, slots=True)
class LabSnapshot:
    """State of a lab between two ticks.

    Attributes:
        tick: The next tick.
        state: State of the cells, and of the plant.
        faults: Injected faults, with their ends so far.
        presence: ``(n, sensors)``, presence bits that the cells read next.
        covered: Changes of the presence bits so far, by tick.
        waiting: Eventual conditions that are false, and for how long.
    """

    tick: int
    state: tuple[bytes, ...]
    faults: tuple[tuple[FaultInstance[FaultSpec], int], ...]
    presence: NDArray[np.bool_]
    covered: tuple[tuple[int, NDArray[np.bool_]], ...]
    waiting: tuple[tuple[str, int], ...]


@final
class Lab(FaultInjection):
    """Cells of an array in lockstep, stepped tick by tick.

    ::

        lab = Lab("hop_gradient", (4, 6), parameters={"goals": [{"cell": [0, 0]}]})
        lab.step(20)
        lab.kill((1, 2))
        lab.step(20)
        print(lab.registers["distance"])

    Messages, clocks, effects and faults are those of a run: the same program with the same faults has the same
    registers at every tick in ``mdms run``.

    Args:
        firmware: A bundled name, ``package.module:Class``, a ``.py`` file, a class, or a function, as in a scene.
        lattice: ``(rows, columns)`` of a rectangle, the ``(row, column)`` of every cell, or a lattice.
        parameters: The firmware's own.
        presence: Presence bits: ``(n,)`` or ``(n, sensors)`` booleans; by tick, the cells covered from that tick on; or
            a function of the lab that returns the bits for the tick to come. None: no cell is covered.
        faults: Tables of a scene's ``[[faults]]``; ``at_tick`` and ``until_tick`` may replace ``at_s`` and ``until_s``.
        effects: Tables of effects of the cells, by name.
        initial_registers: Variables that begin with other values, as ``cells.initial_registers``.
        seed: Seed of all random streams.
        period_s: The control period, s.
        sensors_m: Presence sensors of a cell, from its centre, m; None: one in the centre.
        check: ``stop``: raise ``InvariantBroken`` where a condition of the program is broken; ``count``: collect
            ``violations``; None: conditions are not evaluated.

    Attributes:
        lattice: The cells.
        registers: Registers by name, and by name and cell.
        states: States of the programs by cell.
        inbox: Messages to be read in the next tick, by receiver and side.
        outbox: Messages sent in the last tick, by sender and side.
        violations: Violations so far, with ``check="count"``.

    Raises:
        SceneError: A value is refused; all that is wrong with it, one line each.
        FirmwareError: The firmware can't be loaded or begun.
    """

    def __init__(
        self,
        firmware: object,
        lattice: Cells = (3, 3),
        *,
        parameters: Mapping[str, Any] | None = None,
        presence: PresenceSchedule | None = None,
        faults: Iterable[Mapping[str, Any]] = (),
        effects: Mapping[str, Any] | None = None,
        initial_registers: Mapping[str, Any] | None = None,
        seed: int = 0,
        period_s: float = 0.004096,
        sensors_m: Sequence[tuple[float, float]] | None = None,
        check: Check = "stop",
    ) -> None:
        cells: dict[str, Any] = {"firmware": firmware, "period_s": period_s}
        cells |= {"parameters": dict(parameters or {}), "initial_registers": dict(initial_registers or {})}
        array = _array(lattice)
        if sensors_m is not None:
            array["sensors_m"] = [list(place) for place in sensors_m]
        period_ns = round(Decimal(repr(period_s)) * 10**9)
        scene = load_scene(
            {
                "duration_s": _LONG_S,
                "seed": seed,
                "array": array,
                "cells": cells,
                "friction": {"law": "viscous", "coefficient_s_per_m": 1.0},
                "effects": dict(effects or {}),
                "faults": [in_seconds(one, period_ns) for one in faults],
            }
        )
        self._set_up(scene, plant=False, presence=presence, check=check)

    @classmethod
    def of(
        cls,
        scene: Scene | str | Path | Mapping[str, Any],
        *,
        plant: bool = False,
        presence: PresenceSchedule | None = None,
        check: Check = "stop",
    ) -> Self:
        """Make a lab of a scene's cells, with the scene's faults and effects.

        Args:
            scene: A scene, or what ``load_scene`` takes.
            plant: Whether the scene's plant moves parcels and sets the presence bits. Otherwise parcels are ignored.
            presence: As for ``Lab``; None with a plant.
            check: As for ``Lab``.

        Raises:
            InputError: The scene is refused, or presence is given beside a plant.
        """
        if plant and presence is not None:
            raise InputError("presence: is the plant's with plant=True: leave one of the two out")
        found = scene if hasattr(scene, "cells") else load_scene(cast("str", scene))
        lab = cls.__new__(cls)
        lab._set_up(cast("Scene", found), plant=plant, presence=presence, check=check)  # noqa: SLF001 - our own
        return lab

    def _set_up(self, scene: Scene, *, plant: bool, presence: PresenceSchedule | None, check: Check) -> None:
        self._scene = scene
        self._plant = plant
        self.lattice = scene.lattice()
        self._program = load(scene.cells)
        self._schedule = presence
        self._check: Check = check
        self._monitor = None
        if check is not None and declares_invariants(self._program):
            self._monitor = InvariantMonitor(self._program, scene.cells.firmware)
        self.violations: list[Violation] = []
        self._injected: list[FaultInstance[FaultSpec]] = []
        self._cells = self._built()
        n, sensors = len(self.lattice), len(scene.array.sensors_m)
        self._presence = np.zeros((n, sensors), dtype=np.bool_)
        self._covered: list[tuple[int, NDArray[np.bool_]]] = []
        shard = self._shard
        self.registers = Registers(self.lattice, shard)
        self.states = States(self.lattice, shard)
        self.inbox = MessageSlots(self.lattice, shard, received=True)
        self.outbox = MessageSlots(self.lattice, shard, received=False)
        if isinstance(presence, np.ndarray):
            self.presence = presence

    def _built(self) -> LabCells:
        return CellsOnPlant(self._scene) if self._plant else CellsAlone(self._scene)

    def _shard(self) -> Any:
        return self._cells.shard

    def __repr__(self) -> str:
        name = self._scene.cells.firmware.rpartition("/")[2]
        return f"<Lab of {name}, {len(self.lattice)} cells, before tick {self.tick}>"

    def _repr_html_(self) -> str:
        """Representation in notebooks."""
        facts = [
            ("firmware", self._scene.cells.firmware.rpartition("/")[2]),
            ("cells", f"{len(self.alive)} of {len(self.lattice)} run"),
            ("tick", str(self.tick)),
            ("registers", ", ".join(self.registers.names)),
            ("injected faults", str(len(self._injected))),
            ("plant", "yes" if self._plant else "none: presence bits are given"),
        ]
        return facts_html("Lab", facts)

    # --- time --------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Simulated time at the next tick, s."""
        return self.tick * self._scene.tick_ns * 1e-9

    @property
    def drives(self) -> NDArray[np.float64]:
        """Drives of the last tick, ``(n, 2)``: surface speeds, m/s, or volts with motors."""
        return self._cells.drive

    def step(self, ticks: int = 1) -> Self:
        """Run some ticks.

        Args:
            ticks: Number of ticks.

        Raises:
            InputError: The number is negative.
            FirmwareError: A program failed, and ``cells.on_failure`` of the scene is ``stop``.
            InvariantBroken: A condition of the program is broken.
        """
        if ticks < 0:
            raise InputError(
                f"ticks {ticks}: must be at least 0; restore() goes back to what save() returned"
            )
        cells, monitor = self._cells, self._monitor
        scheduled = callable(self._schedule) or isinstance(self._schedule, Mapping)
        for _ in range(ticks):
            if scheduled:
                self._follow_schedule()
            losses = cells.step(self._presence)
            if losses and self._scene.cells.on_failure == "stop":
                raise _failure(losses, self.lattice)
            if monitor is not None:
                self._evaluate(monitor)
        return self

    def record(self, name: str, ticks: int) -> NDArray[Any]:
        """Run some ticks, and return a register after each, ``(ticks, n, ...)``.

        Args:
            name: Name of the register.
            ticks: Number of ticks.
        """
        return np.array([self.step().registers[name] for _ in range(ticks)])

    def run_until(self, condition: Callable[[Lab], Any], within: int) -> int:
        """Run until a condition of the lab holds, and return the number of ticks.

        Args:
            condition: Evaluated before the first tick and after each.
            within: Most ticks.

        Raises:
            InputError: It doesn't hold within so many ticks.
        """
        for ticks in range(within + 1):
            if condition(self):
                return ticks
            if ticks < within:
                self.step()
        raise InputError(f"within {within}: the condition hasn't come true by tick {self.tick}")

    def view(self) -> ArrayView:
        """Return the registers of the running cells after the last tick, as invariants get them."""
        tick = self.tick - 1
        cells, registers = self._cells.shard.registers()
        rows = self.lattice.find(cells[:, 0], cells[:, 1])
        running = np.zeros(len(self.lattice), dtype=np.bool_)
        running[rows] = True
        if not running.all():
            full = {
                name: np.zeros((len(running), *array.shape[1:]), dtype=array.dtype)
                for name, array in registers.items()
            }
            for name, array in registers.items():
                full[name][rows] = array
            registers = full
        running &= ~self._halted(tick)
        return ArrayView(tick, self.lattice, running, registers, self._scene.bus.link_ticks)

    def _evaluate(self, monitor: InvariantMonitor) -> None:
        disturbed = disturbs(self._faults(), self.tick - 1)
        found = monitor.check(self.view(), disturbed=disturbed)
        if found and self._check == "stop":
            raise InvariantBroken(found)
        self.violations += found

    # --- presence ----------------------------------------------------------------------------------

    @property
    def presence(self) -> NDArray[np.bool_]:
        """Presence bits that the cells read in the next tick, ``(n, sensors)``; not with a plant.

        Can be assigned ``(n,)`` or ``(n, sensors)`` booleans, which hold until they are changed.
        """
        return self._presence.copy()

    @presence.setter
    def presence(self, bits: NDArray[np.bool_]) -> None:
        if self._plant:
            raise InputError("presence: is the plant's; it can't be set")
        given = np.asarray(bits)
        n, sensors = self._presence.shape
        if given.dtype != np.bool_ or given.shape not in ((n,), (n, sensors)):
            raise InputError(
                f"presence: must be booleans of shape ({n},) or ({n}, {sensors}), not {given.dtype} of shape "
                f"{given.shape}"
            )
        full = np.broadcast_to(given.reshape(n, -1), (n, sensors)).copy()
        if not np.array_equal(full, self._presence):
            self._presence = full
            self._covered.append((self.tick, full))

    def cover(self, *cells: CellName) -> None:
        """Cover all sensors of these cells and of no others, until the presence is changed."""
        bits = np.zeros(len(self.lattice), dtype=np.bool_)
        bits[[self._index(cell) for cell in cells]] = True
        self.presence = bits

    def _follow_schedule(self) -> None:
        if isinstance(cast("Any", self._schedule), Mapping):
            by_tick: Mapping[int, Iterable[CellName]] = cast("Any", self._schedule)
            if self.tick in by_tick:
                self.cover(*by_tick[self.tick])
        elif callable(self._schedule):
            self.presence = self._schedule(self)

    # --- save, restore, branch ---------------------------------------------------------------------

    def save(self) -> LabSnapshot:
        """Return the state of the lab before the next tick.

        Raises:
            StateError: A program's state can't be saved; names the type.
        """
        waiting = () if self._monitor is None else self._monitor.waiting(self.tick)
        return LabSnapshot(
            self.tick,
            self._cells.save(),
            tuple((one, one.end_tick) for one in self._injected),
            self._presence.copy(),
            tuple(self._covered),
            waiting,
        )

    def restore(self, snapshot: LabSnapshot) -> Self:
        """Go back, or forward, to what ``save`` returned, in this lab or another one of the same scene."""
        here = [one.number for one in self._injected]
        if here or snapshot.faults:
            self._cells = self._built()
            self._injected = []
            for one, end in snapshot.faults:
                copy = FaultInstance(
                    one.number, one.fault, one.cells, one.start_tick, end, one.injected_at_runtime
                )
                self._cells.inject(copy)
                self._injected.append(copy)
        self._cells.load(snapshot.state, snapshot.tick)
        self._cells.replan()
        self._presence = snapshot.presence.copy()
        self._covered = list(snapshot.covered)
        if self._monitor is not None:
            self._monitor.resume(self.tick, snapshot.waiting, self.alive)
        return self

    def branch(self) -> Lab:
        """Return another lab in the same state, which goes on independently."""
        other = Lab.of(self._scene, plant=self._plant, presence=self._schedule, check=self._check)
        return other.restore(self.save())

    # --- as a scene --------------------------------------------------------------------------------

    @property
    def scene(self) -> Scene:
        """The scene of the lab as it was set up, without injected faults; see ``history``."""
        return self._scene

    def history(self) -> list[dict[str, Any]]:
        """Return the faults of a scene that repeat this lab in ``mdms run``.

        The scene's own come first, then injected ones, then presence bits that were set, as faults
        ``sensor_stuck``. What was set by ``registers``, ``states``, ``inbox`` and ``outbox`` is not repeated.
        """
        return fault_tables(self._scene, self._injected, self._covered, self.lattice, self.tick)

    def save_scene(self, path: str | Path, title: str = "") -> None:
        """Write a scene file that repeats this lab up to now in ``mdms run``; see ``history``."""
        write_scene(Path(path), self._scene, self.history(), self.tick, title)


def _array(lattice: Cells) -> dict[str, Any]:
    """Return the array's table of a scene."""
    if isinstance(lattice, Lattice):
        lattice = lattice.cells
    try:
        sizes_or_cells = list(cast("Iterable[Any]", lattice))
        if len(sizes_or_cells) == 2 and all(isinstance(size, int) for size in sizes_or_cells):
            return {"rows": sizes_or_cells[0], "columns": sizes_or_cells[1]}
        cells = [(row, column) for row, column in sizes_or_cells]
    except (TypeError, ValueError):
        raise InputError(
            f"lattice {lattice!r}: must be (rows, columns), or the (row, column) of every cell"
        ) from None
    if not cells:
        raise InputError("lattice: must have at least one cell")
    rows, columns = (1 + max(cell[axis] for cell in cells) for axis in (0, 1))
    return {"rows": rows, "columns": columns, "cells": [list(cell) for cell in cells]}


def _failure(losses: Sequence[Loss], lattice: Lattice) -> FirmwareError:
    first = losses[0]
    row, column = lattice.cells[first.cell]
    more = len(losses) - 1
    also = f"; {more} cells more failed in that tick" if more else ""
    return FirmwareError(
        f"the program of cell {row},{column} failed in tick {first.tick}: {first.detail}{also}"
    )
