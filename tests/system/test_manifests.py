"""The commands in the manifests are run for real, with paths, hosts and ports of this machine: no container engine."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from deploy.cli import main
from tests.system.small import small_scene

pytest.importorskip("yaml")

from tests.system.manifest_commands import ROOT, Container, of_compose, of_kubernetes, of_systemd

pytestmark = [pytest.mark.slow, pytest.mark.timeout(110)]
PATIENCE_S = 60.0


@dataclass
class Place:
    """This machine in the place of the hosts of a manifest.

    Attributes:
        folder: Folder of the scene, the keys and all volumes.
        port: Port of the router.
        running: Processes by the name of their container.
    """

    folder: Path
    port: int
    running: dict[str, subprocess.Popen[str]] = field(default_factory=dict)

    def write_scene(self, duration_s: float) -> None:
        """Write the scene that stands for the manifests'."""
        (self.folder / "heat.toml").write_text(small_scene(duration_s=duration_s))

    def start(self, container: Container, paths: dict[str, Path]) -> None:
        """Start a process, after what runs before it; ``paths`` are those of the manifest and what they are here."""
        for command in container.before:
            subprocess.run(self.local(command, paths), env=self.environment(), check=True, timeout=30)
        values = self.local(list(container.environment.values()), paths)
        self.running[container.name] = subprocess.Popen(
            self.local(container.command, paths),
            env={**self.environment(), **dict(zip(container.environment, values, strict=True))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def probe(self, container: Container, paths: dict[str, Path]) -> None:
        """Try a container's probe until it says that all is well."""
        (command,) = container.probes
        deadline = time.monotonic() + PATIENCE_S
        while subprocess.run(
            self.local(command, paths), env=self.environment(), timeout=30, check=False
        ).returncode:
            assert self.running[container.name].poll() is None, self.running[container.name].communicate()
            assert time.monotonic() < deadline, f"never well: {command}"

    def local(self, command: list[str], paths: dict[str, Path]) -> list[str]:
        """Return a command of a manifest as it is here."""
        named = [  # the run keeps its name
            str(self.folder / "heat.toml") if word == "heat" and before != "--run" else word
            for before, word in zip(["", *command], command, strict=False)
        ]
        return [self.word(word, paths) for word in named]

    def word(self, word: str, paths: dict[str, Path]) -> str:
        """Return a word of a command as it is here."""
        word = re.sub(r"tls/[a-z0-9.]+:7447", f"tls/127.0.0.1:{self.port}", word)
        word = word.replace("mdms plant heat", f"mdms plant {self.folder / 'heat.toml'}")
        word = word.replace("/opt/mdms/bin/mdms", "mdms").replace("--checkpoint 60", "--checkpoint 0.3")
        for inside, here in paths.items():
            word = word.replace(inside, str(here))
        return word

    def environment(self) -> dict[str, str]:
        """Return an environment in which ``mdms`` is this Python's."""
        path = f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
        return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}

    def end(self, name: str) -> str:
        """Wait until a process has ended well; returns what it printed."""
        said, _ = self.running[name].communicate(timeout=PATIENCE_S)
        assert self.running[name].returncode == 0, f"{name}: {said}"
        return said


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    """Scene, keys and an ``mdms`` to start."""
    (tmp_path / "heat.toml").write_text(small_scene())
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "mdms"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m deploy.cli "$@"\n')
    program.chmod(0o755)
    assert main(["keys", str(tmp_path / "keys"), str(tmp_path / "heat.toml"), "--processes", "2"]) == 0
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    made = Place(tmp_path, port)
    made.write_scene(10.0)
    yield made
    for process in made.running.values():
        with process:
            process.kill()


def digest_of(folder: Path) -> str:
    """Digest of a run that ended well."""
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "ok"
    return summary["digest"]


def expected(place: Place) -> str:
    """Digest of the same run in one process."""
    folder = place.folder / "alone"
    arguments = ("--processes", "0", "--output", str(folder), "--no-picture", "--quiet")
    assert main(["run", str(place.folder / "heat.toml"), *arguments]) == 0
    return digest_of(folder)


def test_the_compose_file_runs(place: Place) -> None:
    services = {service.name: service for service in of_compose()}
    assert set(services) == {"router", "plant", "cells-0", "cells-1"}
    paths = {
        name: {inside: place.folder / host.removeprefix("../../") for inside, host in one.mounts.items()}
        for name, one in services.items()
    }
    for name in ("cells-1", "plant", "cells-0", "router"):  # in no order that anybody would choose
        place.start(services[name], paths[name])
    place.probe(services["plant"], paths["plant"])
    for name in ("plant", "cells-0", "cells-1"):
        place.end(name)
    assert digest_of(place.folder / "data" / "run") == expected(place)


def test_the_manifests_of_kubernetes_run_and_a_plant_that_is_started_again_resumes(place: Place) -> None:
    pods = {pod.name: pod for pod in of_kubernetes()}
    assert set(pods) == {"router", "plant", "cells-0", "cells-1"}
    place.write_scene(40.0)  # a probe takes a second, in which thousands of ticks pass
    archives(place)
    paths = {
        name: {
            inside: place.folder / (f"run-{name}" if volume == "run" else volume)
            for inside, volume in pod.mounts.items()
            if volume != "tmp"
        }
        for name, pod in pods.items()
    }
    (place.folder / "data").mkdir()
    for name in ("plant", "cells-0", "cells-1", "router"):
        place.start(pods[name], paths[name])
    place.probe(pods["plant"], paths["plant"])
    checkpoint = place.folder / "data" / "run" / "checkpoint.msgpack"
    deadline = time.monotonic() + PATIENCE_S
    while not checkpoint.exists():
        assert time.monotonic() < deadline, "no checkpoint came"
        time.sleep(0.02)
    place.running["plant"].kill()
    place.running["plant"].communicate()
    for name in ("cells-0", "cells-1"):  # restartPolicy: OnFailure
        place.running[name].communicate(timeout=PATIENCE_S)
        assert place.running[name].returncode not in (0, 2)
    for name in ("cells-0", "plant", "cells-1"):
        place.start(pods[name], paths[name])
    for name in ("plant", "cells-0", "cells-1"):
        place.end(name)
    summary = json.loads((place.folder / "data" / "run" / "summary.json").read_text())
    assert summary["resumed"]
    assert digest_of(place.folder / "data" / "run") == expected(place)


def archives(place: Place) -> None:
    """Make the Secrets' archives, as the page says."""
    page = (ROOT / "docs" / "clusters.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in page.splitlines() if line.startswith("    tar ")]
    assert len(lines) == 3
    (place.folder / "deploy" / "kubernetes" / "keys").mkdir(parents=True)
    for line in lines:
        for shard in ("0", "1"):
            subprocess.run(
                ["sh", "-c", line.replace("cells-0", f"cells-{shard}")], cwd=place.folder, check=True
            )
    (place.folder / "deploy" / "kubernetes" / "keys").rename(place.folder / "secrets")


def test_the_units_of_systemd_run(place: Place) -> None:
    place.write_scene(0.5)
    units = {unit.name: unit for unit in of_systemd(["0", "1"])}
    assert set(units) == {"mdms-router", "mdms-plant", "mdms-cells@0", "mdms-cells@1"}
    paths = {"/var/lib/mdms": place.folder / "state", "/etc/mdms/keys": place.folder / "keys"}
    for name in ("mdms-cells@0", "mdms-plant", "mdms-router", "mdms-cells@1"):
        place.start(units[name], paths)
    for name in ("mdms-plant", "mdms-cells@0", "mdms-cells@1"):
        place.end(name)
    assert digest_of(place.folder / "state" / "run") == expected(place)
