"""Every benchmark runs, at the smallest size it has, and prints figures; which ones is not looked at."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Smoke:
    """How a script is run at its smallest, and a pattern of the figures that it prints last."""

    arguments: str
    figures: str


N = r"-?[\d.,]+(?:e[-+]\d+)?"
"""A figure."""

SCRIPTS: dict[str, Smoke] = {
    "bus/detection.py": Smoke("--killed 2 --stopped 1 --lease 0.5", rf"\| stopped .* \| 1 \| {N} \| {N} \|"),
    "bus/fuzz_decoders.py": Smoke("--frames 100 --files 10", rf"\| recording, messages \| 5 \| {N} .* 0 \|"),
    "bus/hosts.py": Smoke(
        "--side 4 --duration 0.2 --turns 1", rf"(three: {N} ticks/s; ratio {N}|not measured: .+)"
    ),
    "bus/keys_cost.py": Smoke(
        "--ticks 100 --turns 1 --processes 2", rf"passwords +{N} ticks/s, {N} of plain"
    ),
    "bus/keys_flood.py": Smoke(
        "--ticks 300 --seconds 0.2 --kind late", rf"put {N}; ok, {N} ticks/s, .* {N} late;"
    ),
    "bus/latency.py": Smoke("--delay 2 --ticks 20 --settings 2", rf"1 +2 +{N} +{N} +{N} x"),
    "bus/listeners_cost.py": Smoke("--case 0 --repeat 2", rf"stuck +{N} ticks/s +ratio {N}"),
    "bus/lockstep.py": Smoke(
        "--case 0 --sessions 1 --repeat 2", rf"1 worker, packed +{N} +{N} +{N} +{N} +{N}"
    ),
    "fast.py": Smoke(
        "--cells 1000 --workers 1 --turns 1 --seconds 0.1 --picture ''",
        rf"1 worker, recorded +{N} +{N} +{N} +{N} +{N} +{N} +{N}",
    ),
    "scale.py": Smoke("--quick --seconds 0.1 --picture ''", rf"1,000,000 +100 +40.0 +9 +{N} +plant"),
    "digest_cost.py": Smoke("", rf"10000 +{N} +{N}"),
    "cells/random_draws.py": Smoke("", rf"Scalar +10000 +{N} +{N} +{N}"),
    "cells/board_cost.py": Smoke("--cells 18 --turns 1 --budget 0.02", rf"mux +{N} \({N}-{N}\)"),
    "cells/compiled_step.py": Smoke(
        "--cells 18 --turns 1 --budget 0.02", rf"behavioural +18 +{N} +{N} +{N} +{N} +{N}"
    ),
    "cells/shard_against_cells.py": Smoke("--side 50 --turns 1", rf"arrays are {N} times as fast"),
    "cells/wheel_drive.py": Smoke("", rf"ripple, 256 levels: {N} m/s"),
    "deploy/observation_cost.py": Smoke("--turns 1 --seconds 0.2", rf"--registers 1 +{N} ticks/s +ratio {N}"),
    "deploy/campaign_cost.py": Smoke(
        "--runs 2 --turns 1 --duration 0.05", rf"1 job {N}, 2 jobs {N}: {N} times"
    ),
    "deploy/cluster_campaign.py": Smoke(
        "--runs 4 --turn 4 --duration 0.05", rf"of ideal: {N} by wall time, {N} by processor time"
    ),
    "deploy/campaign_intervals.py": Smoke("--samples 20", rf"exponential +50 +{N}% +{N}%"),
    "deploy/checkpoint_cost.py": Smoke(
        "--repeats 1 --every 0.1 --quick", rf"18 +{N} +{N} +{N} +{N} +{N} +{N}"
    ),
    "deploy/cell_memory.py": Smoke("--scene motors --ticks 2", rf"median {N} MB"),
    "deploy/soak.py": Smoke(
        "--cells 400 --minutes 0.02 --every 0.05", rf"largest {N} MB, slope {N} MB per million ticks"
    ),
    "deploy/viewer_cost.py": Smoke(
        "--cells 400 --turns 1 --seconds 0.3", rf"stopped +ratio {N}  \({N} .. {N}\)"
    ),
    "deploy/view_rate.py": Smoke("--scenes elliptic --seconds 1", rf"elliptic +400 cells +{N} frames/s"),
    "deploy/first_run.py": Smoke("--repeat 1", r"digests: all the same"),
    "deploy/kill_the_plant.py": Smoke("--instants 1 --duration 1", r"1 kills, .*: [0-9a-f]{64}"),
    "deploy/planted_faults.py": Smoke("--programs 2", rf"2 programs in {N} s; 0 with"),
    "deploy/process_faults.py": Smoke("--schedules 1", rf"1 schedules in {N} s: .* 0 with"),
    "deploy/processes_each.py": Smoke(
        "motors --processes 2 --ticks 5 --turns 1", rf"relayed +{N} +{N} +{N} +{N} +{N} +{N}"
    ),
    "deploy/processor_time.py": Smoke(
        "--updates 2000", rf"numbers that differ: 0\n(.*\n)+a byte sent: {N} E"
    ),
    "deploy/warm_start.py": Smoke("--repeat 1", rf"numpy, scipy, zenoh. +{N} s, processor time {N} s"),
    "plant/accuracy_elliptic.py": Smoke("--repeats 1 --quick", rf"the next takes {N} times as long"),
    "plant/captured_chatter.py": Smoke("--scenes 20", rf"scene +\d+: {N} m, nudged {N} m"),
    "plant/chatter_cost.py": Smoke("--turns 1 --quick", rf"dearest .* {N} times as much whole, {N} in ticks"),
    "plant/contact_queues.py": Smoke(
        "--sizes 2 --ticks 5 --turns 1", rf"2 +{N} +{N} +{N} +{N} +{N} +{N} +{N}"
    ),
    "plant/emerging_friction.py": Smoke("--seeds 2 --quick", rf"8 +{N} \+- {N} +{N} +{N} +{N}"),
    "plant/exact_against_scipy.py": Smoke("--turns 1 --runs 1", rf"exact is {N} times as fast"),
    "plant/faults_cost.py": Smoke(
        "--turns 1", rf"lie +acts +{N} us, +{N} +elsewhere +{N} us, +{N} +over +{N} us, +{N}"
    ),
    "plant/many_parcels.py": Smoke(
        "--turns 1 --parcels 25 --side 150", rf"plant, ticks +{N} +{N} +{N} +{N} +{N} +{N}"
    ),
    "plant/mujoco_parcel.py": Smoke("--repeats 1", rf"facts\n\n(.*\n)*.*{N}"),
    "plant/chatter_effects.py": Smoke(
        "--seeds 1 --only uneven_supports", rf"uneven_supports +located +{N} +{N} +\d+ +\d+ +0"
    ),
    "plant/coulomb_effects.py": Smoke("--seeds 1", rf"load_transfer, motors +1e-08 +{N} +{N} +\d+"),
    "plant/coulomb_events.py": Smoke("--seeds 2", rf"1e-10 +{N} +{N} +\d+"),
    "plant/spinning_parcels.py": Smoke("--scenes 21 --turns 1", rf"worst {N} .*within 10: 100.0%"),
    "plant/solvers_compared.py": Smoke("--runs 1", rf"0\.025 +{N}"),
    "protocols/align_over_faults.py": Smoke(
        "--seeds 1 --source camera", rf"camera +10 % dead +{N} +{N} +{N} +{N}%"
    ),
    "protocols/align_sweep.py": Smoke("--quick", rf"camera +{N} +{N} +{N} +{N}%"),
    "protocols/hops_over_bad_links.py": Smoke("--seeds 1", rf"clocks off by up to 5 % +8 +{N} +{N} +{N}"),
    "protocols/junction.py": Smoke("--parcels 8 --gaps 2 --seconds 5", rf"1 +2\.00 +{N} +2\.00 +{N}"),
    "protocols/kit_over_seeds.py": Smoke("--seeds 2", rf"apart by 1; {N} to {N} rounds in {N} ticks"),
    "protocols/lab_speed.py": Smoke(
        "--side 3 --ticks 20 --turns 1 --depth 3", rf"search of 2 x 3 cells: {N} states, .* {N} states/s"
    ),
    "protocols/parcel_estimate.py": Smoke("--seeds 1 --cases loss\\ 0.2", rf"loss 0.2 +{N} +{N} +{N} +{N}"),
    "protocols/parcel_estimate_study.py": Smoke(
        "--seeds 2 --seconds 2.5 --dead 10", rf"2 +10 +{N} +{N} +{N}"
    ),
    "protocols/protocol_report_cost.py": Smoke(
        "--repeats 1 --ticks 40 --sizes 2", rf"200 +{N} +{N} +{N} +{N} +{N}"
    ),
    "protocols/protocols_over_bad_links.py": Smoke("laplace --arrays 2", rf"dead 10 % +{N} +{N} +{N} +{N}"),
    "protocols/sorting_over_bad_links.py": Smoke("--seeds 1", rf"10 % die +{N} +{N} +{N} +{N}"),
    "protocols/vehicle_over_bad_links.py": Smoke("--seeds 1", rf" {N} of {N}\s*$"),
}

NEEDS = {
    "deploy/cluster_campaign.py": "distributed",
    "plant/contact_queues.py": "mujoco",
    "plant/mujoco_parcel.py": "mujoco",
}
"""Packages that come with an extra."""


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(120)
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_benchmark_runs_and_prints_figures(script: str) -> None:
    if script in NEEDS:
        pytest.importorskip(NEEDS[script])
    done = subprocess.run(
        [sys.executable, str(HERE / script), *shlex.split(SCRIPTS[script].arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=110,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "mdms: interrupted\n" not in done.stderr, "of a run that the script has ended"
    assert re.search(SCRIPTS[script].figures, done.stdout), done.stdout


def test_every_benchmark_is_looked_at() -> None:
    scripts = {
        str(path.relative_to(HERE))
        for path in HERE.rglob("*.py")
        if path.name != Path(__file__).name and '__name__ == "__main__"' in path.read_text(encoding="utf-8")
    }
    assert scripts == set(SCRIPTS)


def test_the_table_of_benchmarks_names_each() -> None:
    table = (HERE / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `python tests/benchmarks/(\S+\.py)", table, re.MULTILINE)) == set(SCRIPTS)
