"""Consistency checks between sections of a scene, for all sections that are valid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, cast

from pydantic import ValidationError

from bus.fault import FaultSpec
from cell_firmware.errors import FirmwareError, ParametersError, SettingError
from cell_firmware.faults.base import CellFault
from cell_firmware.specs import CellsSpec
from deploy.faults.registry import Fault
from deploy.scenes.effects import EffectsSpec
from deploy.scenes.errors import KeyPath, Problem, problems_of, strictly
from deploy.scenes.memory_limit import too_many_cells, too_many_parcels
from plant.array import CellArray
from plant.faults.base import PlantFault
from plant.friction.registry import FrictionSpec
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.solver_specs import SolverSpec
from plant.specs import disagreements, misplaced, unknown_exits

_FIRMWARE: KeyPath = ("cells", "firmware")
_PARAMETERS: KeyPath = ("cells", "parameters")


def cross_problems(
    array: ArraySpec | None,
    cells: CellsSpec | None,
    friction: FrictionSpec | None,
    effects: EffectsSpec | None,
    solver: SolverSpec | None,
    faults: Mapping[int, Fault],
    parcels: Mapping[int, ParcelSpec],
) -> list[Problem]:
    """Find disagreements between sections. None stands for an invalid section; checks that depend on it are skipped.

    Args:
        array: The cells that exist.
        cells: The firmware and its parameters.
        friction: The law of traction.
        effects: The effects.
        solver: The solver of the motion.
        faults: Valid faults by their number in the scene.
        parcels: Valid parcels of the scene by their number.
    """
    too_large = list(_too_large(array, effects, parcels))
    if too_large:
        return too_large  # all else is checked on the array that there is no room for
    problems = [Problem(path, rule, value) for path, value, rule in disagreements(friction, effects, solver)]
    if effects is not None:
        problems += [Problem(path, rule, value) for path, value, rule in unknown_exits(parcels, effects)]
        problems += _faults_at_odds(effects, faults)
    if array is not None:
        problems += _fault_problems(array, faults)
        if effects is not None:
            problems += [Problem(path, rule, value) for path, value, rule in misplaced(array, effects)]
    if cells is not None:
        if cells.board is not None:
            problems.append(
                Problem(
                    ("cells", "board"), "this is a bug: boards are expanded when a scene is read", cells.board
                )
            )
        if effects is not None and effects.motors is None and cells.speed_loop is not None:
            problems.append(
                Problem(("cells", "speed_loop"), "needs effects.motors: the speed loop controls motors")
            )
        if effects is not None:
            problems += _board_problems(cells, effects)
            problems += [
                Problem(("effects", *path), rule, value) for path, value, rule in effects.fit_problems(cells)
            ]
        problems += _firmware_problems(array, cells, effects)
        if array is not None:
            problems += _unfit_faults(array, cells, faults)
            problems += _unplaced_registers(array, cells)
    return problems


def _too_large(
    array: ArraySpec | None, effects: EffectsSpec | None, parcels: Mapping[int, ParcelSpec]
) -> Iterator[Problem]:
    """Find sizes in a scene that exceed this machine's memory."""
    if array is not None and (rule := too_many_cells(array.count)):
        side = "rows" if array.rows >= array.columns else "columns"
        yield Problem(("array", side), rule, getattr(array, side))
    feeders = None if effects is None else effects.feeders
    fed = 0 if feeders is None else feeders.total
    if rule := too_many_parcels(len(parcels) + fed):
        yield Problem(("effects", "feeders") if fed else ("parcels",), rule)


def _board_problems(cells: CellsSpec, effects: EffectsSpec) -> list[Problem]:
    """Find board settings that don't fit the motors or their gains."""
    if effects.motors is None or not any((effects.encoder, effects.pwm, effects.fixed_point)):
        return []
    from cell_firmware.build import wheels_of
    from deploy.scenes.motor_facts import motor_facts

    try:
        wheels_of(cells, effects, motor_facts(effects.motors))
    except SettingError as error:
        return [Problem(error.path, error.rule, error.value)]
    return []


def _fault_problems(array: ArraySpec, faults: Mapping[int, Fault]) -> list[Problem]:
    lattice = array.lattice()
    return [
        Problem(("faults", number, *path), rule, value)
        for number, fault in faults.items()
        for path, value, rule in fault.problems(lattice)
    ]


def _faults_at_odds(effects: EffectsSpec, faults: Mapping[int, FaultSpec]) -> list[Problem]:
    return [
        Problem(("faults", number, *path), rule, value)
        for number, fault in faults.items()
        if isinstance(fault, PlantFault)
        for path, value, rule in fault.setting_problems(effects)
    ]


def _unfit_faults(array: ArraySpec, cells: CellsSpec, faults: Mapping[int, FaultSpec]) -> list[Problem]:
    return [
        Problem(("faults", number, *path), rule, value)
        for number, fault in faults.items()
        if isinstance(fault, CellFault)
        for path, value, rule in fault.fit_problems(cells, len(array.sensors_m))
    ]


def _unplaced_registers(array: ArraySpec, cells: CellsSpec) -> list[Problem]:
    """Find initial values of cells that don't exist: no cell would begin with them."""
    lattice = array.lattice()
    names = {f"{row},{column}" for row, column in lattice.cells}
    return [
        Problem(
            ("cells", "initial_registers", name, cell), 'must be of a cell of the array, such as "3,4"', value
        )
        for name, given in cells.initial_registers.items()
        if isinstance(given, Mapping)
        for cell, value in cast("Mapping[str, Any]", given).items()
        if cell not in names
    ]


def _firmware_problems(
    array: ArraySpec | None, cells: CellsSpec, effects: EffectsSpec | None
) -> list[Problem]:
    from cell_firmware import loader
    from cell_firmware.hooks import refusals

    try:
        model = loader.find(cells.firmware).Parameters
    except FirmwareError as error:
        return [Problem(_FIRMWARE, str(error))]
    try:
        with refusals(cells.firmware, "Parameters"):
            try:
                strictly(model, cells.parameters)
            except ValidationError as error:
                return problems_of(error, cells.parameters, model, _PARAMETERS)
        firmware = loader.load(cells)
        if array is not None:
            lattice = array.lattice()
            firmware.check(lattice)
            firmware.check_geometry(lattice, CellArray(array).positions_m, array.pitch_m)
        needed = () if effects is None else firmware.required_effects()
        firmware.uses_camera()  # called for its errors, which belong before the run
    except ParametersError as error:
        return [Problem((*_PARAMETERS, *p.path), p.message, p.value) for p in error.problems]
    except FirmwareError as error:
        return [Problem(_FIRMWARE, str(error))]
    if effects is None:
        return []
    return [
        Problem(("effects", name), f"is missing: with these parameters {cells.firmware} needs it", None)
        for name in needed
        if getattr(effects, name) is None
    ]


def normal_parameters(cells: CellsSpec) -> dict[str, Any]:
    """The firmware's parameters as it understands them, defaults included, in JSON's types."""
    from cell_firmware import loader

    return loader.find(cells.firmware).Parameters.model_validate(cells.parameters).model_dump(mode="json")
