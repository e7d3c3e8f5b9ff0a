"""A wheel brings compiled kernels, an editable installation does not, and both give the same digest."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from deploy import cli
from plant.kernels.common import cache

ROOT = Path(__file__).parents[2]
RUN = ("run", "elliptic", "--duration", "0.05", "--no-picture", "--json")


def _build(hook: str, target: Path, **environment: str) -> Path:
    """Call one of the build backend's hooks, as pip would. Returns the wheel."""
    code = (
        f"import sys; sys.path.insert(0, '.'); import build_backend; print(build_backend.{hook}(sys.argv[1]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(target)],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return target / done.stdout.splitlines()[-1]


def _shipped(wheel: Path) -> list[str]:
    return [name for name in zipfile.ZipFile(wheel).namelist() if cache.SHIPPED.name in name]


def test_an_editable_installation_compiles_nothing(tmp_path: Path) -> None:
    wheel = _build("build_editable", tmp_path)
    assert wheel.name.endswith("-py3-none-any.whl")
    assert not _shipped(wheel)


@pytest.mark.slow
def test_the_first_run_from_a_wheel_compiles_nothing_and_has_the_same_digest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*RUN, "--output", str(tmp_path / "here")]) == 0
    expected = json.loads(capsys.readouterr().out)["digest"]
    compiled, lasting = cache.folder()
    if not lasting:
        pytest.skip("no cache folder can be written here")
    home = tmp_path / "compiled"  # of this scene alone: others would only make the wheel larger
    for name in ("exact", "common", cache.TEXTS):
        shutil.copytree(compiled / name, home / "mdms" / "kernels" / compiled.name / name)
    wheel = _build("build_wheel", tmp_path, NUMBA_CACHE_DIR=str(home), MDMS_WHEEL_SCENES="elliptic")
    minor = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert f"-{minor}-none-linux_" in wheel.name
    assert _shipped(wheel)
    installed = tmp_path / "installed"
    zipfile.ZipFile(wheel).extractall(installed)
    done = subprocess.run(
        [sys.executable, "-m", "deploy.cli", *RUN, "--output", str(tmp_path / "there")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(installed), "NUMBA_CACHE_DIR": str(tmp_path / "fresh")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "compiling" not in done.stderr
    assert json.loads(done.stdout)["digest"] == expected
