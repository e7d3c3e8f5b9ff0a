"""Compiled kernels that a wheel brings: found from another place, read only, and told of where they don't fit."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bus.kernel_cache import processor
from plant.kernels.common import cache
from tests.plant.scenes import TICK_NS, study

ROOT = Path(cache.__file__).parents[3]
PACKAGES = ("bus", "plant", "tests")

RUN = """
import json, sys
from plant.kernels.common import cache
import numpy as np
from tests.plant.scenes import TICK_NS, study
plant = study()
plant.advance(np.zeros((400, 2)), TICK_NS)
from plant.kernels.exact import entry
print(json.dumps({
    "file": cache.__file__,
    "compiled": sum(entry.advance_block.stats.cache_misses.values()),
    "state": plant.state.tobytes().hex(),
    "mismatch": cache.mismatch(),
}))
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A copy of the packages elsewhere, with the kernels of one scene compiled, as a wheel has them; read only."""
    plant = study()
    plant.advance(np.zeros((400, 2)), TICK_NS)
    compiled, lasting = cache.folder()
    if not lasting:
        pytest.skip("no cache folder can be written here")
    place = tmp_path / "elsewhere"
    for name in PACKAGES:
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    shipped = place / "plant" / cache.SHIPPED.name
    for name in ("exact", "common", cache.TEXTS):
        shutil.copytree(compiled / name, shipped / compiled.name / name)
    (shipped / cache.MADE_FOR).write_text(json.dumps(cache.surroundings()))
    for path in shipped.rglob("*"):
        path.chmod(0o555 if path.is_dir() else 0o444)
    yield place
    for path in shipped.rglob("*"):
        path.chmod(0o755)


def _run(place: Path, **environment: str) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(place), **environment},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert Path(str(found["file"])).is_relative_to(place)
    return found


@pytest.mark.parametrize("home", ["empty", "unwritable"])
def test_they_are_loaded_from_another_place_and_give_the_same_bits(
    installed: Path, tmp_path: Path, home: str
) -> None:
    place = tmp_path / home
    if home == "unwritable":
        place.write_text("no folder")
    found = _run(installed, NUMBA_CACHE_DIR=str(place))
    plant = study()
    plant.advance(np.zeros((400, 2)), TICK_NS)
    assert found["compiled"] == 0
    assert found["mismatch"] == ""
    assert found["state"] == plant.state.tobytes().hex()


@pytest.mark.slow
def test_another_version_compiles_and_tells(installed: Path, tmp_path: Path) -> None:
    """Kernels made for another numba are in a folder with another name and another note, which nobody looks for."""
    shipped = installed / "plant" / cache.SHIPPED.name
    (folder,) = (path for path in shipped.iterdir() if path.is_dir())
    for text in (folder / cache.TEXTS).iterdir():
        text.parent.chmod(0o755)
        text.rename(text.with_name("fedcba9876543210"))
    folder.rename(shipped / "0123456789abcdef")
    note = shipped / cache.MADE_FOR
    note.chmod(0o644)
    note.write_text(json.dumps({**cache.surroundings(), "numba": "0.61.2", "Python": "cpython 3.10"}))
    found = _run(installed, NUMBA_CACHE_DIR=str(tmp_path / "home"))
    assert found["compiled"] == 1
    assert "numba 0.61.2 (here " in str(found["mismatch"])
    assert "Python cpython 3.10 (here " in str(found["mismatch"])


def test_without_a_wheel_nothing_is_told() -> None:
    assert cache.mismatch() == ""


@pytest.mark.parametrize(
    ("features", "expected"),
    [
        (set(processor.LEVELS["x86-64-v3"]) | set(processor.LEVELS["x86-64-v2"]), "x86-64-v3"),
        (set(processor.LEVELS["x86-64-v3"]) - {"fma"} | set(processor.LEVELS["x86-64-v2"]), "x86-64-v2"),
        ({"sse2"}, "x86-64"),
        ({"neon"}, "generic"),
    ],
)
def test_the_level_is_the_highest_that_the_processor_has(
    monkeypatch: pytest.MonkeyPatch, features: set[str], expected: str
) -> None:
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    monkeypatch.setattr(
        "llvmlite.binding.get_host_cpu_features", lambda: dict.fromkeys(features, True), raising=True
    )
    assert processor.level.__wrapped__() == (expected, "")


def test_the_environment_names_a_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CPU_NAME", "znver4")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "+avx2")
    assert processor.level.__wrapped__() == ("znver4", "+avx2")


@pytest.mark.slow
def test_every_level_gives_the_same_bits() -> None:
    """No level contracts a product and a sum into one rounding."""
    code = (
        "import numpy as np\nfrom tests.plant.scenes import TICK_NS, elliptic, study\nplant = study()\n"
        "for tick in range(1, 200):\n    plant.advance(elliptic(plant), tick * TICK_NS)\n"
        "print(plant.state.tobytes().hex())"
    )
    states = set()
    for name in [name for name in ("x86-64", processor.level()[0]) if name != "generic"]:
        environment = {
            **os.environ,
            "NUMBA_CPU_NAME": name,
            "NUMBA_CPU_FEATURES": "",
            "PYTHONPATH": str(ROOT),
        }
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        states.add(done.stdout)
    assert len(states) == 1
