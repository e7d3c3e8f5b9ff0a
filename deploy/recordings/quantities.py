"""Loads, slips and tractions at the instants of a recording, from the recorded states and wheel speeds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from plant.analysis.tractions import ArrayTractions, Tractions
from plant.effects.registry import PlantEffects
from plant.specs import PlantSpec

if TYPE_CHECKING:
    from deploy.recordings.format import Header
    from plant.faults.base import WheelFaults

Bools = NDArray[np.bool_]

_OFF_THE_WHEELS = ("tipped", "off_array", "left")
"""Kinds of events after which no wheel carries the parcel."""


def plant_spec(header: Header) -> PlantSpec:
    """Return the physics of a recorded scene.

    Raises:
        ValueError: The header's scene is not one of this version.
    """
    scene = header["scene"]
    effects = {name: table for name, table in scene["effects"].items() if name in PlantEffects.model_fields}
    own = {name: scene[name] for name in PlantSpec.model_fields if name in scene}
    return PlantSpec.model_validate({**own, "effects": effects})


@final
class Conditions:
    """Condition of cells and parcels at the times of a run, from its recorded faults and events.

    Args:
        header: Header of the recording.
        events: Events of the plant.
        faults: Faults and losses.
    """

    def __init__(
        self, header: Header, events: Sequence[Mapping[str, Any]], faults: Sequence[Mapping[str, Any]]
    ) -> None:
        self._cells = {(row, column): index for index, (row, column) in enumerate(header["cells"])}
        policy = header["scene"].get("stall", {}).get("policy", "coast")
        self._policy = "coast" if policy == "abort" else policy
        self._crashes: list[Mapping[str, Any]] = [
            fault for fault in header["scene"].get("faults", ()) if fault.get("kind") == "crash"
        ]
        self._period_ns = header["period_ns"]
        self._events, self._faults = events, faults
        self._parcels = len(header["footprints_m"])
        self._own = header.get("own_parcels", self._parcels)
        self._last: tuple[tuple[int, ...], Bools, Bools] | None = None

    def carried(self, time_s: float) -> list[int]:
        """Return the numbers of the parcels that wheels carry at a time, ascending.

        These are the parcels that were fed and have neither tipped nor left.
        """
        on = set(range(self._own))
        for event in self._events:
            if event["time_s"] > time_s:
                continue
            if event["kind"] == "fed":
                on.add(event["parcel"])
            elif event["kind"] in _OFF_THE_WHEELS:
                on.discard(event["parcel"])
        return sorted(on)

    def cells(self, time_s: float) -> tuple[Bools, Bools]:
        """Return the cells whose wheels turn freely, and the cells out of the array, ``(n,)`` each.

        A transition at ``time_s`` itself is included: it acts from that instant on.
        """
        happened = tuple(k for k, fault in enumerate(self._faults) if fault["time_s"] <= time_s)
        if self._last is None or self._last[0] != happened:
            self._last = happened, *self._after([self._faults[k] for k in happened])
        return self._last[1:]

    def _after(self, faults: Sequence[Mapping[str, Any]]) -> tuple[Bools, Bools]:
        """Cells whose wheels turn freely, and cells out of the array, after these records."""
        coasting = np.zeros(len(self._cells), dtype=np.bool_)
        active: dict[int, Mapping[str, Any]] = {}
        for fault in faults:
            if "phase" not in fault:
                cell = self._cells.get(tuple(fault["cell"]), -1) if fault.get("cell") else -1
                if cell >= 0:
                    coasting[cell] = self._policy_of_crash(fault) == "coast"
            elif fault["kind"] == "respawn":
                coasting[self._indices(fault)] = False
            elif fault["phase"] == "ends":
                active.pop(fault["number"], None)
            elif "fault" in fault:
                active[fault["number"]] = fault
        state = self._wheel_faults(active.values())
        dead = [cell for cell in np.flatnonzero(state.dead).tolist() if not coasting[cell]]
        coasting[[cell for cell in dead if state.wheel_policies.get(cell, self._policy) == "coast"]] = True
        return coasting, state.gone

    def _wheel_faults(self, active: Iterable[Mapping[str, Any]]) -> WheelFaults:
        """Combined effect on the plant of the faults that are active."""
        from deploy.faults.registry import KINDS
        from plant.faults.base import PlantFault, WheelFaults

        state = WheelFaults.healthy(len(self._cells))
        for record in active:
            fault = KINDS[record["kind"]].model_validate(record["fault"])
            if isinstance(fault, PlantFault):
                fault.apply(np.array(self._indices(record), dtype=np.int64), state)
        return state

    def _indices(self, fault: Mapping[str, Any]) -> list[int]:
        return [self._cells[row, column] for row, column in fault["cells"] if (row, column) in self._cells]

    def _policy_of_crash(self, fault: Mapping[str, Any]) -> str:
        """Policy for the wheels of a dead cell: of the scene's crash at that tick, else of the scene."""
        if fault["kind"] == "crash":
            for crash in self._crashes:
                tick = -(-round(crash.get("at_s", 0.0) * 1e9) // self._period_ns)
                if tick * self._period_ns * 1e-9 == fault["time_s"] and crash.get("wheels"):
                    return crash["wheels"]
        return self._policy


@final
class RecordedTractions:
    """Loads, slips and tractions of a recorded run, instant by instant.

    A recorded instant has the parcels' states and the wheels' speeds just before the drives of its tick act. Slips and
    tractions are those of that moment. See ``plant.analysis.tractions``.

    Args:
        header: Header of the recording.
        events: Events of the plant.
        faults: Faults and losses.

    Attributes:
        left_out: Names of the scene's effects that change forces and are not included.

    Raises:
        ValueError: The header's scene is not one of this version.
    """

    def __init__(
        self, header: Header, events: Sequence[Mapping[str, Any]], faults: Sequence[Mapping[str, Any]]
    ) -> None:
        self._tractions = Tractions(plant_spec(header))
        self._conditions = Conditions(header, events, faults)
        self.left_out: tuple[str, ...] = self._tractions.left_out

    def at(
        self, time_s: float, states: NDArray[np.float64], wheel_speeds: NDArray[np.float64]
    ) -> ArrayTractions:
        """Compute the values of one instant.

        Args:
            time_s: Simulated time of the instant, s.
            states: States of the parcels, ``(m, 6)``.
            wheel_speeds: Surface speeds of the wheels, ``(n, 2)``, m/s.
        """
        coasting, absent = self._conditions.cells(time_s)
        return self._tractions.at(
            states,
            wheel_speeds,
            parcels=self._conditions.carried(time_s),
            coasting=coasting,
            absent=absent,
        )
