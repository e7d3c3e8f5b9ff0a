"""The import contracts hold, and each of them bites when it is broken."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("bus", "cell_firmware", "deploy", "mdms", "plant")

LAYERS = "mdms > deploy > plant | cell_firmware > bus"
ZENOH = "Only the zenoh transport and deploy know zenoh"
PHYSICS = "Physics has no clock, no chance, no threads but those that parcels share"
FIRMWARE = "Firmware has no clock, no chance, no threads"
ARITHMETIC = "Firmware computes with NumPy alone"
ACYCLIC = "No modules need each other"
BUS = "Inside bus: fault > lockstep > transports > wire > state"
LOCKSTEP = "Inside bus.lockstep: sides > parts > counters"
PLANT = "Inside plant: process > plant > solvers > kernels"
KERNELS = "Inside the kernels: effects > solvers > common"
DEPLOY = "Inside deploy: commands > studies > runs > workers"
CONTRACTS = {LAYERS, ZENOH, PHYSICS, FIRMWARE, ARITHMETIC, ACYCLIC, BUS, LOCKSTEP, PLANT, KERNELS, DEPLOY}


def broken_contracts(folder: Path) -> set[str]:
    """Names of the contracts that the packages in a folder break."""
    done = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()", "--no-cache"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    lines = done.stdout.splitlines()
    broken, kept = (
        {name for name in CONTRACTS if any(line.startswith(f"{name} {verdict}") for line in lines)}
        for verdict in ("BROKEN", "KEPT")
    )
    assert broken | kept == CONTRACTS, done.stdout + done.stderr
    assert done.returncode == bool(broken)
    return broken


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The packages' sources and the contracts, free to be broken."""
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "*.nb?")
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_every_contract_holds() -> None:
    assert broken_contracts(ROOT) == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "line", "broken"),
    [
        ("bus/lattice.py", "import plant.specs", {LAYERS, PLANT}),
        ("plant/specs.py", "import deploy.errors", {LAYERS}),
        ("plant/specs.py", "import cell_firmware.specs", {LAYERS}),
        ("cell_firmware/specs.py", "import plant.specs", {LAYERS}),
        ("bus/lattice.py", "import zenoh", {ZENOH}),
        ("plant/specs.py", "def late():\n    import zenoh", {ZENOH}),
        ("plant/geometry.py", "import time", {PHYSICS}),
        ("plant/monitors.py", "from concurrent.futures import ThreadPoolExecutor", {PHYSICS}),
        ("plant/geometry.py", "from random import random", {PHYSICS}),
        ("cell_firmware/fields/vortex.py", "import asyncio", {FIRMWARE}),
        ("cell_firmware/speed_loop/floating.py", "from threading import Thread", {FIRMWARE}),
        ("cell_firmware/protocols/velocity_field.py", "from math import exp", {ARITHMETIC}),
        ("bus/lattice.py", "import time", {PHYSICS, FIRMWARE}),
        ("bus/lattice.py", "import bus.wire.keys", {ACYCLIC}),
        ("cell_firmware/fields/sum.py", "import cell_firmware.fields.registry", {ACYCLIC}),
        ("deploy/faults/crash.py", "def late():\n    import deploy.scenes.scene", {ACYCLIC, DEPLOY}),
        ("plant/geometry.py", "if TYPE_CHECKING:\n    import plant.specs", {ACYCLIC, PLANT}),
        ("bus/wire/keys.py", "def late():\n    import bus.transports.memory", {BUS, ACYCLIC}),
        ("bus/lockstep/intervals.py", "import bus.lockstep.receive", {LOCKSTEP}),
        ("plant/friction/law.py", "import plant.effects.wheel_load", {PLANT, ACYCLIC}),
        ("plant/kernels/common/roots.py", "import plant.kernels.exact.segments", {KERNELS, ACYCLIC}),
        ("deploy/util/files.py", "import deploy.security.roles", {DEPLOY, ACYCLIC}),
        ("deploy/workers/pool.py", "import deploy.runs.pace", {DEPLOY, ACYCLIC}),
        ("deploy/errors.py", "import zenoh, asyncio, time, random", set()),
    ],
)
def test_a_contract_that_is_broken_is_named(copy: Path, module: str, line: str, broken: set[str]) -> None:
    path = copy / module
    path.write_text(path.read_text() + f"\n\n{line}\n")
    assert broken_contracts(copy) == broken
