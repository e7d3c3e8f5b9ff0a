"""Manifests of containers and orchestrators are valid, and the validators catch typos."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
COMPOSE = ROOT / "deploy" / "containers" / "compose.yaml"
KUBERNETES = ROOT / "deploy" / "kubernetes"
SYSTEMD = ROOT / "deploy" / "systemd"
MANIFESTS = sorted(path for path in KUBERNETES.glob("*.yaml") if path.name != "kustomization.yaml")


def checked(*command: str) -> subprocess.CompletedProcess[str]:
    """A validator's verdict; it comes from the environment of this Python."""
    program = Path(sys.executable).with_name(command[0])
    if not program.exists():
        pytest.skip(f"{command[0]} is not installed: it comes with the extra manifests")
    return subprocess.run(
        [str(program), *command[1:]], capture_output=True, text=True, check=False, timeout=100
    )


def with_typo(path: Path, folder: Path, right: str, wrong: str) -> str:
    """A copy in which the first occurrence of a word is misspelt."""
    text = path.read_text(encoding="utf-8")
    assert right in text
    copy = folder / path.name
    copy.write_text(text.replace(right, wrong, 1), encoding="utf-8")
    return str(copy)


@pytest.mark.slow
def test_manifests_of_kubernetes_are_valid_and_typos_are_not(tmp_path: Path) -> None:
    done = checked("kubernetes-validate", "--strict", *map(str, MANIFESTS))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(" passed ") + done.stderr.count(" passed ") == 8
    for path, right, wrong in (
        (KUBERNETES / "cells.yaml", "completions:", "completion:"),
        (KUBERNETES / "plant.yaml", "readinessProbe:", "readynessProbe:"),
        (KUBERNETES / "router.yaml", "replicas: 1", "replicas: one"),
        (KUBERNETES / "network-policy.yaml", "policyTypes:", "policyType:"),
    ):
        done = checked("kubernetes-validate", "--strict", with_typo(path, tmp_path, right, wrong))
        assert done.returncode != 0, f"{wrong} passed: {done.stdout}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("", ""),
        ("depends_on:", "depend_on:"),
        ("healthcheck:", "healthchek:"),
        ("read_only: true", "read_only: [1]"),
    ],
)
def test_the_compose_file_is_valid_and_typos_are_not(right: str, wrong: str, tmp_path: Path) -> None:
    file = with_typo(COMPOSE, tmp_path, right, wrong)
    done = checked("check-jsonschema", "--builtin-schema", "vendor.compose-spec", file)
    assert (done.returncode == 0) == (not wrong), done.stdout + done.stderr


def test_what_the_kustomization_names_is_there() -> None:
    text = (KUBERNETES / "kustomization.yaml").read_text(encoding="utf-8")
    named = re.findall(r"^  - (\S+\.yaml)$", text, re.MULTILINE)
    assert sorted(named) == [path.name for path in MANIFESTS]


@pytest.mark.slow
def test_the_kustomization_makes_the_secrets_that_pods_mount(tmp_path: Path) -> None:
    if shutil.which("kubectl") is None:
        pytest.skip("no kubectl, which renders a kustomization")
    folder = tmp_path / "kubernetes"
    shutil.copytree(KUBERNETES, folder)
    (folder / "keys").mkdir(exist_ok=True)
    for name in ("router", "plant", "cells-0", "cells-1"):
        (folder / "keys" / f"{name}.tar").write_bytes(b"")
    rendered = subprocess.run(
        ["kubectl", "kustomize", str(folder)], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    made = set(re.findall(r"^kind: Secret\nmetadata:\n  name: (\S+)$", rendered, re.MULTILINE))
    assert made == set(re.findall(r"secretName: (\S+)$", rendered, re.MULTILINE))
    (tmp_path / "rendered.yaml").write_text(rendered)
    done = checked("kubernetes-validate", "--strict", str(tmp_path / "rendered.yaml"))
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_systemd_understands_the_units(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze")
    for unit in SYSTEMD.glob("*.service"):
        text = unit.read_text(encoding="utf-8").replace("/opt/mdms/bin/mdms", "/bin/true")
        (tmp_path / unit.name).write_text(text, encoding="utf-8")
    units = [str(path) for path in sorted(tmp_path.glob("*.service"))]
    assert len(units) == 3
    assert verdict(units) == ""
    typo = tmp_path / "mdms-router.service"
    typo.write_text(typo.read_text().replace("RestartSec=", "RestartSecs="))
    assert "RestartSecs" in verdict(units)


def verdict(units: list[str]) -> str:
    """Complaints of systemd about units."""
    done = subprocess.run(
        ["systemd-analyze", "verify", *units], capture_output=True, text=True, check=False, timeout=60
    )
    return done.stdout + done.stderr


def test_the_image_is_built_of_files_that_are_there_and_runs_as_no_root() -> None:
    text = (ROOT / "deploy" / "containers" / "Containerfile").read_text(encoding="utf-8")
    stages = text.split("FROM ")
    assert 'ENTRYPOINT ["mdms"]' in stages[-1]
    assert re.search(r"^USER 10001:10001$", stages[-1], re.MULTILINE)
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    needed = ("bus", "build_backend.py", "cell_firmware", "deploy", "hatch_build.py", "mdms", "plant")
    assert not set(needed) & set(ignored)
    assert all((ROOT / name).exists() for name in needed)
