"""A command imports what it needs and no more, so that it answers at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
HEAVY = ("numba", "scipy", "matplotlib", "zenoh", "mcap", "lz4", "bokeh", "tornado")
REPORT = """
import sys
from deploy.cli import main
status = main({arguments})
print(status, *sorted(sys.modules), file=sys.stderr)
"""


def imported_by(*arguments: str) -> set[str]:
    """Modules and packages that a command has imported."""
    done = subprocess.run(
        [sys.executable, "-c", REPORT.format(arguments=list(arguments))],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    status, *modules = done.stderr.split()
    assert status == "0"
    return set(modules)


def test_help_imports_nothing_heavy_not_even_numpy_or_pydantic_models() -> None:
    imported = imported_by("--help")
    assert imported.isdisjoint({*HEAVY, "numpy", "bus", "cell_firmware"})
    # the flag that signals set, which needs nothing
    assert {name for name in imported if name.startswith("plant.")} == {"plant.stop"}


@pytest.mark.parametrize("arguments", [("scenes",), ("scenes", "elliptic"), ("schema",), ("run", "--help")])
def test_commands_that_compute_nothing_import_nothing_heavy(arguments: tuple[str, ...]) -> None:
    assert imported_by(*arguments).isdisjoint(HEAVY)


def test_the_module_runs_as_a_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "deploy.cli", "scenes", "eliptic"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("scene eliptic: ")
