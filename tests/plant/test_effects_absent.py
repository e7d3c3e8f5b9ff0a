"""An effect that is absent is not in the code: kernels for scenes without it are compiled to the same instructions."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EFFECTS = ("loaded_wheels", "roller_impacts", "uneven_springs", "wheel_edges")
"""The kernel modules that belong to effects."""

COMPILE = """
import hashlib, importlib, json, re, sys
for effect in sys.argv[2:]:
    importlib.import_module(f"plant.kernels.{effect}")
from numba import njit, typeof
from tests.plant.scenes import parcel, solved

solver = sys.argv[1]
names = ("entry", "block") if solver == "exact" else ("implicit_entry", "implicit_block")
entry, block = (importlib.import_module(f"plant.kernels.{name}") for name in names)

class Called(Exception):
    pass

def take(*arguments):
    raise Called(arguments)

entry.advance_block = take
try:
    solved({"name": solver}, parcel())
except Called as called:
    arguments = called.args[0]
compiled = njit(error_model="numpy", _nrt=False)(block.advance_block.py_func)
compiled.compile(tuple(typeof(argument) for argument in arguments))
text = compiled.inspect_llvm(compiled.signatures[0])
# addresses of Python's own objects in this process
text = re.sub(r"numba\\.dynamic\\.globals\\.[0-9a-f]+|inttoptr \\(i64 \\d+ to ptr\\)", "address", text)
print(json.dumps([len(text), hashlib.sha256(text.encode()).hexdigest()]))
"""


def _compiled(solver: str, *effects: str) -> subprocess.Popen[str]:
    """A fresh process that compiles a solver's kernels for a scene without effects, with ``effects`` known to it."""
    return subprocess.Popen(
        [sys.executable, "-c", COMPILE, solver, *effects],
        cwd=ROOT,
        # the instructions before they are optimised: the same in means the same out, and it takes half the time
        env={**os.environ, "NUMBA_OPT": "0", "PYTHONHASHSEED": "0", "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("solver", ["implicit"])
def test_kernels_without_effects_are_the_same_whether_or_not_effects_exist(solver: str) -> None:
    processes = [_compiled(solver), _compiled(solver, *EFFECTS)]
    told = [process.communicate()[0] for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    without, known = (json.loads(text.splitlines()[-1]) for text in told)
    assert without[0] > 1_000_000
    assert without == known


def test_every_kernel_module_of_an_effect_is_looked_at() -> None:
    """Those that answer for surfaces with something of their own."""
    answering = {
        path.stem for path in (ROOT / "plant" / "kernels").glob("*.py") if "own=True" in path.read_text()
    }
    assert answering == set(EFFECTS)
