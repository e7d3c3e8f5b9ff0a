"""Compile the solvers once, before any test: no test's time limit should have to hold a compiler's run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture import providers

# The same examples every time, however slow the machine is: what fails once fails again.
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")

# Hypothesis also draws numbers that it reads in whatever modules of ours are loaded: the examples of a test would then
# hang on which others ran before it, and a failure could not be met again by running it alone.
providers._get_local_constants = lambda: providers._local_constants

GROUPS = (("exact",), ("implicit", "fixed_step", "quasi_static"))
"""Solvers compiled side by side: each group takes about as long as the other."""

COMPILE = """
import sys
import numpy as np
from plant.plant import Plant
from plant.specs import PlantSpec
for name in sys.argv[1:]:
    plant = Plant(PlantSpec.model_validate({
        "array": {"rows": 2, "columns": 2},
        "parcels": [{"size_m": (0.15, 0.15), "mass_kg": 1.0, "position_m": (0.0, 0.0)}],
        "friction": {"law": "viscous", "coefficient_s_per_m": 0.2},
        "solver": {"name": name},
    }))
    plant.advance(np.zeros((4, 2)), 1_000_000)
"""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of the nightly tier."""
    parser.addoption(
        "--nightly",
        action="store_true",
        help="all tests, the slow ones too; 200 random schedules, all solvers compared, fuzzers for ten minutes",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Leave nothing out at night, unless told to."""
    if config.getoption("nightly") and config.option.markexpr == "not slow":
        config.option.markexpr = ""


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels where this version's are not on disk yet: processes that tests start find them there."""
    from plant.kernels.common.cache import is_warm

    if is_warm() or session.config.option.collectonly or "PYTEST_XDIST_WORKER" in os.environ:
        return
    session.config.get_terminal_writer().line("compiling the solvers (once) ...")
    compilers = [
        subprocess.Popen([sys.executable, "-c", COMPILE, *names], cwd=session.config.rootpath)
        for names in GROUPS
    ]
    assert [compiler.wait() for compiler in compilers] == [0] * len(GROUPS)


FOLDERS = {
    "system": ("system",),
    "stability": ("stability",),
    "studies": (
        "deploy/studies/accuracy",
        "deploy/studies/campaign",
        "deploy/studies/effects",
        "deploy/studies/orientations",
    ),
    "kernels": ("plant", "deploy/checkpoints", "deploy/runs"),
}
"""Folders of a mark."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of a tier by their folder; ``slow`` is marked where a test stands."""
    for item in items:
        for name, folders in FOLDERS.items():
            if any(Path(__file__).parent / folder in item.path.parents for folder in folders):
                item.add_marker(name)
