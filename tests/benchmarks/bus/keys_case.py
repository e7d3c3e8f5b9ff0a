"""What ``keys_cost.py`` and ``keys_flood.py`` have in common: a scene, its keys, and a run by ``mdms``."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.scenes.files import load_scene
from deploy.security.generate import generate_keys
from deploy.security.manifest import Kind
from deploy.workers.plan import Processes, RunOptions, plan
from tests.system.small import small_scene

ROOT = Path(__file__).resolve().parents[3]
PERIOD_NS = 4_096_000


@dataclass(frozen=True)
class Run:
    """How the scene is run."""

    scene: Path
    processes: Processes
    keys: Path | None
    output: Path
    join: str | None = None

    def command(self, ticks: int) -> list[str]:
        """The whole command line."""
        command = [
            sys.executable,
            "-m",
            "deploy.cli",
            "run",
            str(self.scene),
            "--json",
            "--quiet",
            "--no-picture",
        ]
        command += ["--processes", str(self.processes), "--output", str(self.output)]
        command += ["--duration", str(ticks * PERIOD_NS / 1e9)]
        command += [] if self.keys is None else ["--keys", str(self.keys)]
        return command + ([] if self.join is None else ["--join", self.join])


def write_scene(folder: Path) -> Path:
    """The scene as a file."""
    path = folder / "keys.toml"
    path.write_text(small_scene(columns=6, duration_s=1.0))
    return path


def keys_for(scene: Path, processes: Processes, folder: Path, kind: Kind) -> Path:
    """Keys of its runs."""
    made = plan(load_scene(str(scene)), RunOptions(processes), "RUN")
    generate_keys(folder, made.scene, made.cut, kind, hosts=(), days=1, force=False)
    return folder


def run_once(run: Run, ticks: int) -> dict[str, Any]:
    """Its summary."""
    done = subprocess.run(
        run.command(ticks), capture_output=True, text=True, check=True, timeout=300, cwd=ROOT
    )
    return json.loads(done.stdout)
