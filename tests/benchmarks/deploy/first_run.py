"""How long the first run takes: from a checkout with nothing compiled, from a wheel, and later ones.

``python tests/benchmarks/deploy/first_run.py`` measures and prints its method. It needs ``hatchling``; other
libraries are those of this environment.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

METHOD = """\
Method. Each command is a process of its own, timed from its start to its end, in seconds; processor time is of it and
its processes. Cold: no compiled kernels, and no font list of matplotlib. Wheel: built here with the kernels of this
scene, unpacked, and run with an empty cache folder. Warm: the same command once more; medians of {repeat}."""


def _run(home: Path, code: Path, *options: str) -> tuple[float, float, str]:
    """Run the scene. Returns wall time, processor time, and the digest."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(home / "numba"),
        "MPLCONFIGDIR": str(home / "matplotlib"),
        "MPLBACKEND": "Agg",
        "PYTHONPATH": str(code),
    }
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "deploy.cli", "run", "elliptic", *options, "--json"]
        before, begun = os.times(), time.perf_counter()
        done = subprocess.run(
            [*command, "--output", folder],
            cwd=folder,
            env=environment,
            check=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        wall, after = time.perf_counter() - begun, os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, spent, json.loads(done.stdout)["digest"]


def _wheel(place: Path, home: Path) -> Path:
    """Build a wheel with the kernels in a cache folder, and unpack it."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(home / "numba"),
        "MDMS_WHEEL_SCENES": "elliptic",
        "PYTHONPATH": str(ROOT),
    }
    code = "import sys, build_backend; print(build_backend.build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(place)],
        cwd=ROOT,
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    zipfile.ZipFile(place / done.stdout.splitlines()[-1]).extractall(place / "installed")
    compile_all = [sys.executable, "-m", "compileall", "-q", str(place / "installed")]
    subprocess.run(compile_all, check=True)  # as pip does
    return place / "installed"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    repeat = parser.parse_args().repeat
    print(METHOD.format(repeat=repeat))
    place = Path(tempfile.mkdtemp(prefix="mdms-first-run-"))
    digests: set[str] = set()

    def measure(name: str, home: str, code: Path, *options: str, times: int = 1) -> None:
        taken = sorted(_run(place / home, code, *options) for _ in range(times))
        wall, spent, _ = taken[len(taken) // 2]
        digests.update(one[2] for one in taken if not options)
        print(f"{name:<46} {wall:5.1f} s, of processor time {spent:5.1f} s", flush=True)

    try:
        measure("checkout, cold", "checkout", ROOT)
        measure("checkout, warm", "checkout", ROOT, times=repeat)
        installed = _wheel(place, place / "checkout")
        measure("wheel, first run", "wheel", installed)
        measure("wheel, warm", "wheel", installed, times=repeat)
        measure("wheel, warm, --duration 0.01", "wheel", installed, "--duration", "0.01", times=repeat)
        print(f"load while this ran: {os.getloadavg()[1]:.1f} on {os.cpu_count()} processors")
        print("digests: all the same" if len(digests) == 1 else f"DIGESTS DIFFER: {sorted(digests)}")
        if len(digests) != 1:
            raise SystemExit(1)
    finally:
        shutil.rmtree(place, ignore_errors=True)


if __name__ == "__main__":
    main()
