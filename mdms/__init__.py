"""Public Python API of the MDMS emulator: names re-exported from its packages, imported when they are first used.

::

    import mdms

    with mdms.Simulation.open(mdms.load_scene("elliptic")) as simulation:
        result = simulation.run()
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from bus.errors import BusError
    from bus.lattice import SIDES, Lattice
    from bus.spec import Finite, NotNegative, Positive, Spec, Vector
    from bus.wire.message_type import bounded_list
    from cell_firmware.array_view import ArrayView, Violation
    from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs
    from cell_firmware.errors import FirmwareError, ParametersError, Problem
    from cell_firmware.firmware import Cells, Firmware, Inbox, Inputs, Outbox, Outputs, State
    from cell_firmware.program import NoParameters, Program, Theory
    from cell_firmware.scalar_program import ScalarProgram, scalar_function
    from deploy.errors import DeployError, InputError
    from deploy.lab.lab import Lab, LabSnapshot
    from deploy.live.client import LiveRun
    from deploy.live.frame import RunFrame
    from deploy.recordings.exports.registry import export_recording
    from deploy.recordings.info import RecordingInfo, recording_info
    from deploy.recordings.reader import load as load_recording
    from deploy.recordings.recording import CellTrace, ParcelTrace, Recording
    from deploy.runs.backends import CellsBackend, InProcess, Workers
    from deploy.runs.checking import InvariantBroken
    from deploy.runs.result import RunResult
    from deploy.runs.simulation import Simulation
    from deploy.scenes.errors import SceneError
    from deploy.scenes.files import bundled_names as scene_names
    from deploy.scenes.files import load_scene
    from deploy.scenes.scene import Scene
    from plant.errors import PlantError
    from plant.observations import Event, ParcelStatus
    from plant.plant import Plant
    from plant.specs import PlantSpec
    from plant.tick import TickHooks, TickRecord

__all__ = [
    "SIDES",
    "ArrayView",
    "BusError",
    "Cell",
    "CellFirmware",
    "CellInputs",
    "CellOutputs",
    "CellTrace",
    "Cells",
    "CellsBackend",
    "DeployError",
    "Event",
    "Finite",
    "Firmware",
    "FirmwareError",
    "InProcess",
    "Inbox",
    "InputError",
    "Inputs",
    "InvariantBroken",
    "Lab",
    "LabSnapshot",
    "Lattice",
    "LiveRun",
    "NoParameters",
    "NotNegative",
    "Outbox",
    "Outputs",
    "ParametersError",
    "ParcelStatus",
    "ParcelTrace",
    "Plant",
    "PlantError",
    "PlantSpec",
    "Positive",
    "Problem",
    "Program",
    "Recording",
    "RecordingInfo",
    "RunFrame",
    "RunResult",
    "ScalarProgram",
    "Scene",
    "SceneError",
    "Simulation",
    "Spec",
    "State",
    "Theory",
    "TickHooks",
    "TickRecord",
    "Vector",
    "Violation",
    "Workers",
    "bounded_list",
    "export_recording",
    "load_recording",
    "load_scene",
    "recording_info",
    "scalar_function",
    "scene_names",
]

_MODULES: Final = {
    "bus.errors": ("BusError",),
    "bus.lattice": ("Lattice", "SIDES"),
    "bus.spec": ("Finite", "NotNegative", "Positive", "Spec", "Vector"),
    "cell_firmware.cell": ("Cell", "CellFirmware", "CellInputs", "CellOutputs"),
    "cell_firmware.errors": ("FirmwareError", "ParametersError", "Problem"),
    "cell_firmware.firmware": ("Cells", "Firmware", "Inbox", "Inputs", "Outbox", "Outputs", "State"),
    "cell_firmware.array_view": ("ArrayView", "Violation"),
    "bus.wire.message_type": ("bounded_list",),
    "cell_firmware.scalar_program": ("ScalarProgram", "scalar_function"),
    "cell_firmware.program": ("NoParameters", "Program", "Theory"),
    "deploy.errors": ("DeployError", "InputError"),
    "deploy.lab.lab": ("Lab", "LabSnapshot"),
    "deploy.live.client": ("LiveRun",),
    "deploy.live.frame": ("RunFrame",),
    "deploy.recordings.exports.registry": ("export_recording",),
    "deploy.recordings.info": ("RecordingInfo", "recording_info"),
    "deploy.recordings.reader": ("load_recording=load",),
    "deploy.recordings.recording": ("CellTrace", "ParcelTrace", "Recording"),
    "deploy.runs.backends": ("CellsBackend", "InProcess", "Workers"),
    "deploy.runs.checking": ("InvariantBroken",),
    "deploy.runs.result": ("RunResult",),
    "deploy.runs.simulation": ("Simulation",),
    "deploy.scenes.errors": ("SceneError",),
    "deploy.scenes.files": ("load_scene", "scene_names=bundled_names"),
    "deploy.scenes.scene": ("Scene",),
    "plant.errors": ("PlantError",),
    "plant.observations": ("Event", "ParcelStatus"),
    "plant.plant": ("Plant",),
    "plant.specs": ("PlantSpec",),
    "plant.tick": ("TickHooks", "TickRecord"),
}
_PLACES: Final = {
    name.partition("=")[0]: (module, name.rpartition("=")[2])
    for module, names in _MODULES.items()
    for name in names
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'mdms' has no attribute {name!r}")
    module, attribute = _PLACES[name]
    _check_package(module.partition(".")[0])
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


def _check_package(name: str) -> None:
    """Refuse a folder of the caller's that has the name of one of our packages and is found first."""
    ours = Path(__file__).resolve().parents[1]
    found = [Path(place).resolve() for place in getattr(import_module(name), "__path__", ())]
    if ours / name not in found:
        where = found[0] if found else "a module"
        raise ImportError(
            f"mdms needs its own package {name!r}, but {where} is found first: rename that folder, "
            "or start Python elsewhere"
        )
