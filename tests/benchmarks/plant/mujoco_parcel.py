"""The same parcels on the same wheels in MuJoCo: what it makes of them, and what that costs.

``python tests/benchmarks/plant/mujoco_parcel.py`` needs the extra ``mujoco``; it measures all in one process and
prints its tables. With ``--docs DIR`` it writes them into ``DIR/mujoco.md`` instead, between their marks, and draws
the picture.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from mujoco_model import CONTACTS, COULOMB, MU, SAMPLE_S, Contact, run, speeds_of
from mujoco_picture import draw
from mujoco_tables import cells_table, held_table, loads_table, viscous_table

from deploy.plots.theme import write_picture
from deploy.scenes.scene import Scene
from deploy.studies.accuracy.experiments.markdown import error, milliseconds, power, table
from deploy.studies.accuracy.experiments.runs import ExperimentTrace, max_displacement_m, scene_with
from deploy.studies.accuracy.experiments.runs import run as run_ours
from deploy.studies.accuracy.page import facts

Floats = NDArray[np.float64]

STEPS_S = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)
OURS: tuple[dict[str, Any], ...] = (
    *({"step_s": step} for step in STEPS_S),
    *({"tolerance": tolerance} for tolerance in (1e-3, 1e-5, 1e-7)),
)


@dataclass(frozen=True)
class Case:
    """A scene, and what its parcel should do.

    Attributes:
        name: in tables.
        scene: a bundled one, with Coulomb's law.
        known: its course; in closed form, or by the implicit solver at 1e-9.
        agreement_m: how far the implicit solver is off that at 1e-8.
    """

    name: str
    scene: Scene
    known: ExperimentTrace
    agreement_m: float


@dataclass(frozen=True)
class Row:
    """One model at one step or tolerance.

    Attributes:
        model: MuJoCo's contacts, or ``implicit``.
        setting: its step or tolerance.
        step_s: of MuJoCo; None: ours.
        errors_m: by case; None where it failed.
        spent_s: for a simulated second, by case.
        aloft: share of the samples of the last case at which fewer than three cells touch; NaN for ours.
    """

    model: str
    setting: str
    step_s: float | None
    errors_m: list[float | None]
    spent_s: list[float]
    aloft: float


def cases() -> list[Case]:
    """A belt, a spin on a belt, and the elliptic field."""
    belt = scene_with(
        "coulomb", "parcels.0.angle_rad=0.0", "parcels.0.angular_velocity_rad_s=0.0", "duration_s=1.0"
    )
    found = [_case("belt", belt, _on_a_belt), _case("spin", scene_with("coulomb"))]
    return [*found, _case("elliptic", scene_with("elliptic", *COULOMB, "duration_s=3.0"))]


def _case(
    name: str, scene: Scene, closed: Callable[[ExperimentTrace], ExperimentTrace] | None = None
) -> Case:
    known = run_ours(scene, {"name": "implicit", "tolerance": 1e-9}, sample_s=SAMPLE_S)
    other = run_ours(scene, {"name": "implicit", "tolerance": 1e-8}, sample_s=SAMPLE_S)
    if closed is not None:
        known = closed(known)
    return Case(name, scene, known, float(max_displacement_m(other, known).max()))


def _on_a_belt(one: ExperimentTrace) -> ExperimentTrace:
    """Set down at rest: ``mu g t^2 / 2`` until ``V / (mu g)``, and from then on with the belt."""
    speed, pull = 0.2, MU * 9.81
    t = one.time_s
    way = np.where(t < speed / pull, 0.5 * pull * t**2, speed * t - 0.5 * speed**2 / pull)
    state = np.zeros_like(one.state)
    state[:, :2] = one.state[0, :2]
    state[:, 0] += way
    return ExperimentTrace(t, state, one.footprint_m, (), 0, 0.0)


def theirs(case: Case, contact: Contact, step_s: float, repeats: int) -> tuple[float | None, float, float]:
    """(error, m, or None; processor time a simulated second; share of samples with fewer than three cells)."""
    runs = [
        run(case.scene, speeds_of(case.scene), MU, step_s, contact, case.scene.duration_s)
        for _ in range(repeats)
    ]
    spent = statistics.median(one.spent_s for one in runs)
    state = np.zeros_like(case.known.state)
    state[:, :3] = runs[0].state
    off = float(
        max_displacement_m(
            ExperimentTrace(case.known.time_s, state, case.known.footprint_m, (), 0, 0.0), case.known
        ).max()
    )
    return None if runs[0].failed else off, spent, float(np.mean(runs[0].touching < 3))


def compare(known: Sequence[Case], repeats: int) -> list[Row]:
    """MuJoCo with all contacts and steps; ours with all settings."""
    rows: list[Row] = []
    for contact in CONTACTS:
        for step in STEPS_S:
            done = [theirs(case, contact, step, repeats) for case in known]
            name = f"MuJoCo, {contact.title}"
            rows.append(
                Row(
                    name,
                    f"{step * 1e3:g} ms",
                    step,
                    [one[0] for one in done],
                    [one[1] for one in done],
                    done[-1][2],
                )
            )
    for settings in OURS:
        runs = [
            run_ours(case.scene, {"name": "implicit", **settings}, sample_s=SAMPLE_S, repeats=repeats)
            for case in known
        ]
        errors = [
            float(max_displacement_m(one, case.known).max()) for one, case in zip(runs, known, strict=True)
        ]
        (key, value), *_ = settings.items()
        setting = f"{value * 1e3:g} ms" if key == "step_s" else f"tolerance {power(value)}"
        spent = [one.spent_s / case.scene.duration_s for one, case in zip(runs, known, strict=True)]
        rows.append(Row("`implicit`", setting, None, list(errors), spent, np.nan))
    return rows


def error_table(known: Sequence[Case], rows: Sequence[Row]) -> str:
    """The first table."""
    heading = ["model", "step", *(f"{case.name}, m" for case in known), "aloft", "time"]
    lines = [
        [
            row.model,
            row.setting,
            *("failed" if one is None else error(one) for one in row.errors_m),
            "–" if np.isnan(row.aloft) else f"{100.0 * row.aloft:.0f} %",
            milliseconds(row.spent_s[-1]),
        ]
        for row in rows
    ]
    return table(heading, lines)


def write_into(page: Path, tables: dict[str, str]) -> None:
    """Put the tables between their marks."""
    text = page.read_text(encoding="utf-8")
    for name, lines in tables.items():
        text, found = re.subn(
            rf"(<!-- {name} -->\n)(?:.*?\n)??(<!-- end -->)",
            lambda match, lines=lines: f"{match[1]}{lines}\n{match[2]}",
            text,
            flags=re.DOTALL,
        )
        if found != 1:
            raise SystemExit(f"{page}: has the marks of table {name} {found} times, must have them once")
    page.write_text(text, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="for each time")
    parser.add_argument("--docs", type=Path, help="write tables and picture into the page there")
    options = parser.parse_args()
    known = cases()
    rows = compare(known, options.repeats)
    tables = {
        "errors": error_table(known, rows),
        "reference": table(
            ["case", "`implicit` at 1e-8 off, m"],
            [[f"{case.name}", error(case.agreement_m)] for case in known],
        ),
        "held": held_table(),
        "loads": loads_table(),
        "viscous": viscous_table(),
        "cells": cells_table(options.repeats),
        "facts": facts(("mujoco", "numpy", "numba")),
    }
    if options.docs is None:
        print("\n\n".join(f"{name}\n\n{lines}" for name, lines in tables.items()))
        return
    write_into(options.docs / "mujoco.md", tables)
    folder = options.docs / "images" / "mujoco"
    folder.mkdir(parents=True, exist_ok=True)
    write_picture(lambda: draw(rows), folder / "cost.png")


if __name__ == "__main__":
    main()
