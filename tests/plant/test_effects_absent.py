"""An effect that is absent is not in the code: not in the compiled, nor in what is loaded or made."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EFFECTS = (
    "load_transfer",
    "loaded_wheels",
    "roller_drag",
    "roller_impacts",
    "stiction",
    "uneven_friction",
    "uneven_springs",
    "wheel_edges",
)
"""The kernel modules that belong to effects."""

SOLVERS = {
    "exact": "exact.block",
    "implicit": "implicit.block",
    "fixed_step": "fixed.block",
    "quasi_static": "quasi.block",
}
"""The module of the kernel that each compiled solver calls."""

COMPARED = ("exact",)
"""Solvers whose kernels are compiled here, twice.

With ``--nightly`` all are compared.
"""

COMPILE = """
import hashlib, importlib, json, re, sys
solvers = dict(one.split("=") for one in sys.argv[1].split(","))
for effect in sys.argv[2:]:
    importlib.import_module(f"plant.kernels.effects.{effect}")
from numba import njit, typeof
from tests.plant.scenes import parcel, solved

class Called(Exception):
    pass

def take(*arguments):
    raise Called(arguments)

for solver, block in solvers.items():
    entry = importlib.import_module("plant.kernels." + block.replace("block", "entry"))
    entry.advance_block = take
    try:
        solved({"name": solver}, parcel())
    except Called as called:
        arguments = called.args[0]
    kernel = importlib.import_module(f"plant.kernels.{block}").advance_block
    compiled = njit(error_model="numpy", _nrt=False)(kernel.py_func)
    compiled.compile(tuple(typeof(argument) for argument in arguments))
    text = compiled.inspect_llvm(compiled.signatures[0])
    # addresses of Python's own objects in this process
    text = re.sub(r"numba\\.dynamic\\.globals\\.[0-9a-f]+|inttoptr \\(i64 \\d+ to ptr\\)", "address", text)
    print(json.dumps([solver, len(text), hashlib.sha256(text.encode()).hexdigest()]))
"""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Compare the kernels of a few solvers, or of all."""
    if "compared" in metafunc.fixturenames:
        compared = tuple(SOLVERS) if metafunc.config.getoption("nightly") else COMPARED
        metafunc.parametrize("compared", [compared], ids=["-".join(compared)])


def _compiling(compared: Sequence[str], *effects: str) -> subprocess.Popen[str]:
    """A fresh process that compiles solvers' kernels for a scene without effects, ``effects`` known to it.

    One after another, since they have most of what they call in common.
    """
    return subprocess.Popen(
        [
            sys.executable,
            "-c",
            COMPILE,
            ",".join(f"{name}={SOLVERS[name]}" for name in compared),
            *effects,
        ],
        cwd=ROOT,
        # the instructions before they are optimised: the same in means the same out, and it takes half the time
        env={**os.environ, "NUMBA_OPT": "0", "PYTHONHASHSEED": "0", "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_kernels_without_effects_are_the_same_whether_or_not_effects_exist(compared: tuple[str, ...]) -> None:
    processes = [_compiling(compared), _compiling(compared, *EFFECTS)]
    outputs = [process.communicate()[0] for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    without, known = ([json.loads(line) for line in text.splitlines()] for text in outputs)
    assert [solver for solver, _, _ in without] == list(compared)
    assert min(length for _, length, _ in without) > 1_000_000
    assert without == known


def test_every_kernel_module_of_an_effect_is_checked() -> None:
    """Those that answer for surfaces with something of their own."""
    folder = ROOT / "plant" / "kernels" / "effects"
    answering = {path.stem for path in folder.glob("*.py") if "own=True" in path.read_text()}
    assert answering == set(EFFECTS)


OF_FAULTS = ("plant.faults.schedule", "plant.faults.faulty_wheels")
"""The modules that only faults need."""

PLANT = ROOT / "plant"
SPECS = {"spec"}
"""What a scene is checked by, whether or not it has the effect."""


def _modules(folder: Path, but: set[str]) -> Iterator[str]:
    for path in sorted(folder.rglob("[!_]*.py")):
        if path.stem not in but:
            yield ".".join(path.relative_to(ROOT).with_suffix("").parts)


OF_EFFECTS = (
    *OF_FAULTS,
    *(
        name
        for folder in (PLANT / "effects").iterdir()
        if folder.is_dir()
        for name in _modules(folder, SPECS)
    ),
    *_modules(PLANT / "kernels" / "effects", set()),
    *_modules(PLANT / "kernels" / "contact", set()),
)
"""The modules that only effects need, or faults."""

MOVE = """
import gc, json, sys
from tests.plant.scenes import SECOND, elliptic, parcel, solved
for solver in sys.argv[1].split(","):
    plant = solved({"name": solver}, parcel())
    plant.advance(elliptic(plant), SECOND // 10)
made = {type(one) for one in gc.get_objects()}
print(json.dumps([sorted(sys.modules), [f"{one.__module__}.{one.__name__}" for one in made]]))
"""


def test_a_scene_without_effects_loads_no_code_of_theirs_and_makes_nothing_of_it() -> None:
    assert all(find_spec(name) for name in OF_EFFECTS)
    moved = subprocess.run(
        [sys.executable, "-c", MOVE, ",".join(SOLVERS)], cwd=ROOT, check=True, capture_output=True, text=True
    )
    loaded, made = json.loads(moved.stdout.splitlines()[-1])
    assert "plant.plant" in loaded
    assert set(OF_EFFECTS) & set(loaded) == set()
    # the table of effects itself, empty
    of_effects = {name for name in made if name.startswith("plant.effects.")}
    assert of_effects == {"plant.effects.registry.PlantEffects"}
