"""The import contracts hold, and each of them bites when it is broken."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("bus", "cell_firmware", "deploy", "mdms", "plant")

LAYERS = "mdms > deploy > plant | cell_firmware > bus"
ZENOH = "Only the zenoh transport and deploy know zenoh"
PHYSICS = "Physics has no clock, no chance, no threads but those that parcels share"
FIRMWARE = "Firmware has no clock, no chance, no threads"
ARITHMETIC = "Firmware computes with NumPy, or in cell_firmware.kernels"
ACYCLIC = "No modules need each other"
BUS = "Inside bus: fault > lockstep > transports > wire > state"
LOCKSTEP = "Inside bus.lockstep: sides > parts > counters"
PLANT = "Inside plant: process > plant > solvers > kernels"
KERNELS = "Inside the kernels: effects > solvers > common"
DEPLOY = "Inside deploy: commands > studies > runs > workers"
CONTRACTS = {LAYERS, ZENOH, PHYSICS, FIRMWARE, ARITHMETIC, ACYCLIC, BUS, LOCKSTEP, PLANT, KERNELS, DEPLOY}


@dataclass(frozen=True)
class Breakage:
    """An import that should not be, and what the report has to say of it.

    Attributes:
        module: The file that it is added to.
        line: The code that is added.
        imported: What the report calls what is imported; several where the line has several.
        broken: The contracts that it breaks, but ``ACYCLIC``.
        cycle_in: The package in which it closes a cycle.
    """

    module: str
    line: str
    imported: Sequence[str]
    broken: frozenset[str] = frozenset()
    cycle_in: str | None = None

    @property
    def imports(self) -> list[str]:
        """How the report names it."""
        importer = self.module.removesuffix(".py").replace("/", ".")
        return [f"{importer} -> {one}" for one in self.imported]


def breaks(
    module: str, line: str, *broken: str, by: Sequence[str] = (), cycle_in: str | None = None
) -> Breakage:
    """A breakage; ``by`` is said where it is not the line's last word."""
    return Breakage(module, line, by or (line.rsplit(maxsplit=1)[-1],), frozenset(broken), cycle_in)


@dataclass(frozen=True)
class Report:
    """What lint-imports says of the packages in a folder: by contract that is broken, how."""

    broken: dict[str, str]

    @classmethod
    def of(cls, folder: Path) -> Report:
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                "from importlinter.cli import lint_imports_command as c; c()",
                "--no-cache",
            ],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=100,
        )
        verdicts, _, details = done.stdout.partition("Broken contracts")
        broken, kept = (
            {name for name in CONTRACTS if re.search(f"^{re.escape(name)} {verdict}", verdicts, re.MULTILINE)}
            for verdict in ("BROKEN", "KEPT")
        )
        assert broken | kept == CONTRACTS, done.stdout + done.stderr
        assert done.returncode == bool(broken)
        headings = "|".join(re.escape(name) for name in broken)
        parts = re.split(rf"^({headings})\n-+\n", details, flags=re.MULTILINE) if broken else [""]
        found = dict(zip(parts[1::2], parts[2::2], strict=True))
        assert found.keys() == broken, done.stdout
        return cls(found)

    def naming(self, what: str) -> set[str]:
        """The contracts that are broken by an import, ``importer -> imported``."""
        named = re.compile(rf"(?<![\w.]){re.escape(what)} \(l\.")
        return {name for name, how in self.broken.items() if named.search(how)}

    @property
    def cycles_in(self) -> list[str]:
        """Packages with cycles."""
        return re.findall(r"^No cycles are allowed in (\S+)\.$", self.broken.get(ACYCLIC, ""), re.MULTILINE)


TOGETHER: dict[str, tuple[Breakage, ...]] = {
    "between packages": (
        breaks("bus/lattice.py", "import plant.specs", LAYERS, PLANT),
        breaks("plant/specs.py", "import deploy.errors", LAYERS),
        breaks("plant/specs.py", "import cell_firmware.specs", LAYERS),
        breaks("cell_firmware/specs.py", "import plant.specs", LAYERS),
        breaks(
            "deploy/faults/crash.py", "def late():\n    import deploy.scenes.scene", DEPLOY, cycle_in="deploy"
        ),
        breaks("plant/geometry.py", "if TYPE_CHECKING:\n    import plant.specs", PLANT, cycle_in="plant"),
    ),
    "of others' packages": (
        breaks("bus/lattice.py", "import zenoh", ZENOH),
        breaks("plant/specs.py", "def late():\n    import zenoh", ZENOH),
        breaks("plant/geometry.py", "import time", PHYSICS),
        breaks("plant/monitors.py", "from concurrent.futures import Future", PHYSICS, by=["concurrent"]),
        breaks("plant/geometry.py", "from random import random", PHYSICS),
        breaks("cell_firmware/fields/vortex.py", "import asyncio", FIRMWARE),
        breaks(
            "cell_firmware/speed_loop/floating.py", "from threading import Thread", FIRMWARE, by=["threading"]
        ),
        breaks("cell_firmware/protocols/velocity_field.py", "from math import exp", ARITHMETIC, by=["math"]),
        breaks("bus/lattice.py", "import time", PHYSICS, FIRMWARE),
        breaks("bus/lattice.py", "import bus.wire.keys", cycle_in="bus"),
        breaks("plant/friction/law.py", "import plant.effects.wheel_load", PLANT, cycle_in="plant"),
        breaks("deploy/util/files.py", "import deploy.security.roles", DEPLOY, cycle_in="deploy"),
        breaks(
            "deploy/errors.py",
            "import zenoh, asyncio, time, random",
            by=["zenoh", "asyncio", "time", "random"],
        ),
    ),
    "inside packages": (
        breaks(
            "cell_firmware/fields/sum.py",
            "import cell_firmware.fields.registry",
            cycle_in="cell_firmware.fields",
        ),
        breaks("bus/wire/keys.py", "def late():\n    import bus.transports.memory", BUS, cycle_in="bus"),
        breaks("bus/lockstep/intervals.py", "import bus.lockstep.receive", LOCKSTEP),
        breaks(
            "plant/kernels/common/roots.py",
            "import plant.kernels.exact.segments",
            KERNELS,
            cycle_in="plant.kernels",
        ),
        breaks("deploy/workers/pool.py", "import deploy.runs.headless", DEPLOY, cycle_in="deploy"),
    ),
}
"""Breakages that one report can tell apart: none makes another's import part of a chain that breaks more."""


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
    assert Report.of(ROOT).broken == {}


@pytest.mark.parametrize("breakages", TOGETHER.values(), ids=TOGETHER.keys())
def test_a_contract_that_is_broken_is_named_with_the_import_that_breaks_it(
    copy: Path, breakages: tuple[Breakage, ...]
) -> None:
    for one in breakages:
        path = copy / one.module
        path.write_text(path.read_text() + f"\n\n{one.line}\n")
    report = Report.of(copy)
    for one in breakages:
        for what in one.imports:
            assert report.naming(what) == one.broken, what
    assert sorted(report.cycles_in) == sorted(one.cycle_in for one in breakages if one.cycle_in is not None)
    of_cycles = {ACYCLIC} if report.cycles_in else set[str]()
    assert set(report.broken) == of_cycles.union(*(one.broken for one in breakages))


def test_each_contract_is_broken_once_at_least() -> None:
    breakages = [one for together in TOGETHER.values() for one in together]
    assert {ACYCLIC}.union(*(one.broken for one in breakages)) == CONTRACTS
    assert any(one.cycle_in for one in breakages)
