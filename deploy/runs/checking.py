"""Checker of a run's invariants: conditions of the cells' program, evaluated on the registers of every tick."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal, final

from bus.lockstep.registers import RegisterRequest
from cell_firmware.array_view import ArrayView, Violation
from cell_firmware.errors import FirmwareError
from cell_firmware.invariants import InvariantMonitor
from deploy.errors import DeployError
from deploy.scenes.fault_schedule import disturbs, halted_cells

if TYPE_CHECKING:
    from bus.fault import FaultInstance, FaultSpec
    from bus.lattice import Lattice
    from bus.lockstep.registers import RegisterSnapshot
    from deploy.runs.result import RunResult
    from deploy.scenes.scene import Scene
    from plant.tick import TickRecord

Check = Literal["stop", "count"]

_LISTED: Final = 1_000
"""Most violations that are kept; later ones are counted."""


class InvariantBroken(DeployError):
    """An invariant of the cells' program does not hold, or an eventual condition hasn't come true in time.

    Attributes:
        violations: The violations of the tick.
    """

    def __init__(self, violations: Sequence[Violation]) -> None:
        super().__init__("; ".join(map(str, violations)))
        self.violations = tuple(violations)


@final
class RunChecker:
    """Checker of the conditions of a scene's program, in a run.

    Args:
        scene: The scene.
        lattice: Its cells.
        check: ``stop``: raise at the first violation; ``count``: go on.
        faults: Returns the faults of the run, those injected so far included.

    Attributes:
        violations: The first violations.
        counts: Number of violations by rule.
    """

    def __init__(
        self,
        scene: Scene,
        lattice: Lattice,
        check: Check,
        faults: Callable[[], Sequence[FaultInstance[FaultSpec]]],
    ) -> None:
        from cell_firmware.loader import load

        program = load(scene.cells)
        self._monitor = InvariantMonitor(program, scene.cells.firmware)
        self._lattice = lattice
        self._link_ticks = scene.bus.link_ticks
        self._check: Check = check
        self._faults = faults
        self.violations: list[Violation] = []
        self.counts: Counter[str] = Counter()

    @property
    def wanted(self) -> tuple[RegisterRequest, ...]:
        """The registers that the cells publish for the checker: all, in every tick."""
        return (RegisterRequest(1),)

    def take(self, shown: RegisterSnapshot) -> None:
        """Evaluate the conditions on the registers of a tick.

        Raises:
            InvariantBroken: A condition is broken, and the run stops then.
            DeployError: The program's conditions raised.
        """
        faults, tick = self._faults(), shown.tick
        running = shown.cells & ~halted_cells(faults, tick, len(self._lattice))
        view = ArrayView(tick, self._lattice, running, shown.registers, self._link_ticks)
        try:
            found = self._monitor.check(view, disturbed=disturbs(faults, tick))
        except FirmwareError as error:
            raise DeployError(str(error)) from error
        if not found:
            return
        self.counts.update(one.rule for one in found)
        self.violations += found[: _LISTED - len(self.violations)]
        if self._check == "stop":
            raise InvariantBroken(found)

    def hook(self, drain: Callable[[], Sequence[RegisterSnapshot]]) -> Callable[[TickRecord], None]:
        """Return a hook after each tick that checks the drained registers."""

        def after_tick(record: TickRecord) -> None:
            del record
            for shown in drain():
                self.take(shown)

        return after_tick

    def judge(self, result: RunResult) -> None:
        """Fail a run that went on to its end in spite of violations."""
        if result.ok and self.violations:
            result.end("failed", self.summary())

    def as_json(self) -> dict[str, Any]:
        """Return the number of violations, the number by rule, and the first violations, in JSON's types."""
        return {
            "violations": self.counts.total(),
            "by_rule": dict(self.counts),
            "first": [one.as_json() for one in self.violations],
        }

    def summary(self) -> str:
        """Return the violations in a line: the first, and how many there are; empty without any."""
        if not self.violations:
            return ""
        first, total = str(self.violations[0]), self.counts.total()
        return first if total == 1 else f"{first}; {total} violations in all"
