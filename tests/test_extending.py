"""The recipes of ``docs/extending.md``, followed in a copy of the packages: files made, lines changed, commands run."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override

pytestmark = pytest.mark.system  # each recipe is a process

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
PACKAGES = ("bus", "cell_firmware", "deploy", "mdms", "plant")
FILE = re.compile(r"^```(?:python|toml)\n# (\S+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
CHANGE = re.compile(r"^```diff\n# (\S+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^```\n(mdms run small\.toml .*?)^```", re.DOTALL | re.MULTILINE)
COMPARED = re.compile(r"`(tests/\S+\.py::test_[\w\[\]]+)`")
"""Tests that fail until pages and tests have the addition."""

START, *REST = re.split(r"^## (.+)\n", PAGE, flags=re.MULTILINE)
RECIPES = dict(zip(REST[::2], REST[1::2], strict=True))
MU_G = 9.81
"""For a coefficient of 1."""

RUN = """
import json, sys
import mdms
from deploy.scenes.overrides import Override
scene = mdms.load_scene("small.toml", [Override.parse(text) for text in sys.argv[1:]])
with mdms.Simulation.open(scene) as simulation:
    ticks = []
    while (record := simulation.step()) is not None:
        ticks.append({"drives": record.drives.tolist(), "after": record.after[0].tolist()})
import plant
json.dump({"ticks": ticks, "plant": plant.__file__, "columns": scene.array.columns}, sys.stdout)
"""


class Motion(NamedTuple):
    """A run of the page's scene.

    Attributes:
        after: ``(ticks, 6)`` state of the parcel at the end of every tick.
        driven: ``(ticks, columns)`` whether a cell of the column is driven along x.
    """

    after: NDArray[np.float64]
    driven: NDArray[np.bool_]


Again = Callable[[str, str], Motion]
"""Runs the command of a recipe with one text in place of another."""


# --- following the page -------------------------------------------------------------------------------------------


def copied(folder: Path, *more: str) -> Path:
    for name in (*PACKAGES, *more):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.nb?", "images"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def followed(recipe: str, folder: Path) -> None:
    """Do as a recipe says: make its files, change the lines that it changes."""
    for name, text in FILE.findall(recipe):
        assert not (folder / name).exists(), name
        (folder / name).write_text(text, encoding="utf-8")
    for name, text in CHANGE.findall(recipe):
        changed = (folder / name).read_text(encoding="utf-8")
        for hunk in re.split(r"^(?=@@)", text, flags=re.MULTILINE):
            changed = patched(changed, hunk)
        (folder / name).write_text(changed, encoding="utf-8")


def patched(text: str, hunk: str) -> str:
    """Apply a hunk: its lines that are kept or removed stand in the text once, after the line that ``@@`` names."""
    head, lines = "", hunk.splitlines(keepends=True)
    if lines and lines[0].startswith("@@"):
        head = lines.pop(0).removeprefix("@@").strip()
    if not lines:
        return text
    above, below = "", text
    if head:
        above, found, below = text.partition(head)
        assert found, head
        above += found
    old = "".join(line[1:] for line in lines if line[0] != "+")
    new = "".join(line[1:] for line in lines if line[0] != "-")
    assert head or below.count(old) == 1, old
    assert old in below, old
    return above + below.replace(old, new, 1)


def settings(recipe: str) -> list[str]:
    """What the command of a recipe sets."""
    (command,) = COMMAND.findall(recipe)
    words = shlex.split(command.replace("\\\n", ""))
    assert words[:3] == ["mdms", "run", "small.toml"]
    assert set(words[3::2]) == {"--set"}
    return words[4::2]


def in_copy(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), **variables},
        capture_output=True,
        text=True,
        check=False,
        timeout=110,
    )


def run(folder: Path, *sets: str) -> Motion:
    done = in_copy(folder, "-c", RUN, *sets)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert Path(told["plant"]).is_relative_to(folder)
    drives = np.array([tick["drives"] for tick in told["ticks"]])
    driven = (drives[:, :, 0] != 0.0).reshape(len(drives), -1, told["columns"]).any(axis=1)
    return Motion(np.array([tick["after"] for tick in told["ticks"]]), driven)


# --- the recipes' results -----------------------------------------------------------------------------------------


def law(motion: Motion, again: Again) -> None:
    """Every wheel slips: the parcel is accelerated at mu g, far less than without the cap."""
    after, acceleration = motion.after, 0.05 * MU_G
    time_s = 0.004 * np.arange(1, len(after) + 1)
    np.testing.assert_allclose(after[:, 3], acceleration * time_s, rtol=1e-6)
    np.testing.assert_allclose(after[:, 0], 0.5 * acceleration * time_s**2, rtol=1e-6)
    assert f"{acceleration:.2f} m/s²" in RECIPES["A friction law"]


def field(motion: Motion, again: Again) -> None:
    """The torques of a square of equal loads balance at half the rate of shear."""
    assert motion.after[-1, 5] == pytest.approx(-0.5, rel=1e-3)
    np.testing.assert_allclose(motion.after[:, :2], 0.0, atol=1e-9)


def protocol(motion: Motion, again: Again) -> None:
    """The parcel lies over columns 2 to 4."""
    links = np.array([2, 1, 0, 0, 0, 1, 2])
    ticks = np.arange(len(motion.driven))[:, None]
    assert (motion.driven == (links <= ticks)).all()


def effect(motion: Motion, again: Again) -> None:
    """The western column under the parcel loses it in time; columns 5 and 6 are one link and two from column 4."""
    assert motion.driven[[0, 5, 10], [4, 5, 6]].all()
    first = motion.driven.argmax(axis=0)
    assert first[[4, 5, 6]].tolist() == [0, 5, 10]
    every = again("every_ticks = 5", "every_ticks = 1")
    assert every.driven.argmax(axis=0)[[4, 5, 6]].tolist() == [0, 1, 2]


def fault(motion: Motion, again: Again) -> None:
    ticks = np.arange(len(motion.driven))
    assert (motion.driven.any(axis=1) == (ticks % 4 < 2)).all()
    assert 0.3 < motion.after[-1, 0] / (0.2 * 0.2) < 0.6


def solver(motion: Motion, again: Again) -> None:
    """``v = V (1 - exp(-mu g t))``, to second order in the step."""
    rate, span_s = 0.5 * MU_G, 0.2
    exact = 0.2 * (1.0 - math.exp(-rate * span_s))
    halved = again("0.002", "0.001")
    errors = [abs(one.after[-1, 3] - exact) for one in (motion, halved)]
    assert 0.0 < errors[0] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)


RESULTS: dict[str, Callable[[Motion, Again], None]] = {
    "A friction law": law,
    "A velocity field": field,
    "A neighbour protocol": protocol,
    "An effect of cells": effect,
    "A fault kind": fault,
    "A solver": solver,
}


# --- tests --------------------------------------------------------------------------------------------------------


def test_every_recipe_has_files_a_command_and_tests_to_extend() -> None:
    assert RECIPES.keys() == RESULTS.keys()
    for name, recipe in RECIPES.items():
        assert FILE.search(recipe), name
        assert COMPARED.search(recipe), name
        steps = re.findall(r"^(\d+)\. ", recipe, re.MULTILINE)
        assert steps == [str(k + 1) for k in range(len(steps))], name


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_leads_to_what_the_page_says(name: str, tmp_path: Path) -> None:
    folder = copied(tmp_path)
    followed(START, folder)
    followed(RECIPES[name], folder)
    sets = settings(RECIPES[name])
    with pytest.raises(SceneError):  # the packages themselves don't have it
        load_scene(folder / "small.toml", [Override.parse(text) for text in sets])

    def again(old: str, new: str) -> Motion:
        assert any(old in text for text in sets)
        return run(folder, *(text.replace(old, new) for text in sets))

    RESULTS[name](run(folder, *sets), again)


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy, tests and pages included, in which all recipes were followed as far as their last step."""
    folder = copied(tmp_path_factory.mktemp("all"), "docs", "tests")
    for recipe in RECIPES.values():
        followed(recipe, folder)
    return folder


@pytest.mark.slow
def test_the_additions_keep_the_import_contracts_and_the_style(everything: Path) -> None:
    contracts = in_copy(
        everything, "-c", "from importlinter.cli import lint_imports_command as c; c()", "--no-cache"
    )
    assert contracts.returncode == 0, contracts.stdout
    style = in_copy(everything, "-m", "ruff", "check", "--no-cache", *PACKAGES)
    assert style.returncode == 0, style.stdout
    layout = in_copy(everything, "-m", "ruff", "format", "--check", "--no-cache", *PACKAGES)
    assert layout.returncode == 0, layout.stdout + layout.stderr


@pytest.mark.slow
def test_the_tests_that_the_page_names_fail_until_they_are_extended(everything: Path) -> None:
    named = sorted(set(COMPARED.findall(PAGE)))
    assert len(named) == 7
    done = in_copy(
        everything, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "-q", "--compile-late", *named
    )
    failed = set(re.findall(r"^FAILED (tests/\S+\.py::test_[\w\[\]]+)", done.stdout, re.MULTILINE))
    assert failed == set(named), done.stdout
