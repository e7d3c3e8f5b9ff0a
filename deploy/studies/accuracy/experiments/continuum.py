"""Convergence of an array's torque to a continuous surface's as the pitch shrinks."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, final

import numpy as np

from deploy.plots.map_view import INK
from deploy.plots.theme import write_picture
from deploy.studies.accuracy.experiments.markdown import Section, panels, picture, prose, table
from deploy.studies.accuracy.experiments.runs import scene_with
from deploy.studies.orientations.study import study
from deploy.util.colours import colour
from plant.analysis.crossings import TURN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from plant.analysis.orientations import TorqueProfile

SIZE_M = (10.3, 5.2)
PITCHES_M = (1.0, 0.5, 0.25, 0.125)
FILE = "continuum.png"
_HEADING = (
    "pitch, m",
    "cells below at 0°",
    "steps a turn",
    "rms error / peak",
    "every 0.05°",
    "largest torque / peak",
)
_SEEN = "Left: the staircases at pitch 1 and a quarter about the sine. Right: rms error over the peak against pitch"
_EVERY_RAD = math.radians(0.05)
_NAMES = {1.0: "1", 0.5: "½", 0.25: "¼", 0.125: "⅛"}


@final
@dataclass(frozen=True, slots=True)
class ContinuumRow:
    """Result for the array at one pitch.

    Attributes:
        pitch_m: between cells.
        under: cells that carry the parcel at angle 0.
        steps: angles a turn at which supports change.
        rms: error of the torque over all angles, over the peak of the continuous one: the integral, without sampling.
        sampled: the same from angles every 0.05 degrees.
        most: the largest torque over that peak.
        profile: torque against angle.
        peak_n_m: of the continuous surface, with the sign it has at 45 degrees.
    """

    pitch_m: float
    under: int
    steps: int
    rms: float
    sampled: float
    most: float
    profile: TorqueProfile
    peak_n_m: float


def sets(pitch_m: float) -> tuple[str, ...]:
    """Return the ``--set`` values for ``elliptic``: the parcel on a central cell, and the cells within reach."""
    cells = 2 * math.ceil(5.8 / pitch_m) + 1
    return (
        f"array.rows={cells}",
        f"array.columns={cells}",
        f"array.pitch_m={pitch_m:g}",
        f"parcels.0.size_m=[{SIZE_M[0]}, {SIZE_M[1]}]",
        "parcels.0.position_m=[0.0, 0.0]",
        "cells.parameters.field.ky_per_s=-0.5",
    )


def measure() -> list[ContinuumRow]:
    """Every pitch."""
    return [_row(pitch) for pitch in PITCHES_M]


def _row(pitch_m: float) -> ContinuumRow:
    orientation_study = study(scene_with("elliptic", *sets(pitch_m)), 0, (0.0, 0.0))
    profile = orientation_study.profile()
    angles = np.arange(0.0, TURN, _EVERY_RAD)
    smooth = orientation_study.continuous(np.append(angles, math.pi / 4.0))
    assert smooth is not None
    peak = float(smooth[-1])
    sampled = profile.torque_at(angles) - smooth[:-1]
    return ContinuumRow(
        pitch_m=pitch_m,
        under=int(profile.supports[-1]),
        steps=len(profile.angles_rad),
        rms=rms_error(profile, peak) / abs(peak),
        sampled=float(np.sqrt(np.mean(sampled**2))) / abs(peak),
        most=float(np.max(np.abs(profile.torque_n_m))) / abs(peak),
        profile=profile,
        peak_n_m=peak,
    )


def rms_error(profile: TorqueProfile, peak_n_m: float) -> float:
    """Root of the mean square, over a turn, of a staircase less ``peak sin(2 theta)``: step by step in closed form."""
    low = profile.angles_rad
    high = np.append(low[1:], low[0] + TURN)
    cross = 0.5 * (np.cos(2.0 * low) - np.cos(2.0 * high))
    torque = profile.torque_n_m
    total = float(np.sum(torque**2 * (high - low) - 2.0 * peak_n_m * torque * cross))
    return math.sqrt(max(total / TURN + 0.5 * peak_n_m**2, 0.0))


def section(repeats: int) -> Section:
    """The section of the page; nothing in it is timed."""
    del repeats
    return describe(measure())


def describe(rows: Sequence[ContinuumRow]) -> Section:
    """Describe the measurements in Markdown."""
    orders = [f"{math.log2(one.rms / two.rms):.2f}" for one, two in pairwise(rows)]
    settings = " ".join(f"--set '{one}'" for one in sets(PITCHES_M[0]))
    text = prose(
        "continuum",
        length=f"{SIZE_M[0]:g}",
        width=f"{SIZE_M[1]:g}",
        picture=picture(FILE, _SEEN),
        table=table(_HEADING, [_line(row) for row in rows]),
        orders=f"{', '.join(orders[:-1])} and {orders[-1]}",
        under=str(rows[0].under),
        beyond=f"{(rows[0].most - 1.0) * 100.0:.0f}",
        command=f"mdms orientations elliptic --at 0,0 {settings} --json",
    )
    return Section(
        "From cells to a continuous surface", text, {FILE: partial(write_picture, partial(draw, rows))}
    )


def _line(row: ContinuumRow) -> tuple[str, ...]:
    return (
        _NAMES[row.pitch_m],
        f"{row.under:,}",
        f"{row.steps:,}",
        f"{row.rms:.4f}",
        f"{row.sampled:.4f}",
        f"{row.most:.3f}",
    )


def draw(rows: Sequence[ContinuumRow]) -> Figure:
    """Two of the staircases over half a turn, and the error against pitch."""
    figure, (left, right) = panels(
        "The torque of cells tends to that of a surface",
        f"parcel {SIZE_M[0]:g} × {SIZE_M[1]:g} m centred on a cell  ·  V = (−x, −y/2)",
        widths_in=(5.4, 3.6),
        height_in=3.4,
    )
    fine = np.radians(np.linspace(0.0, 180.0, 721))
    left.plot(
        np.degrees(fine), np.sin(2.0 * fine), color="#8fa0b2", lw=1.8, zorder=2, label="continuous surface"
    )
    for row, shade in ((rows[0], INK), (rows[2], colour(1))):
        values = np.append(row.profile.torque_n_m[-1], row.profile.torque_n_m) / row.peak_n_m
        edges = np.concatenate([[0.0], np.degrees(row.profile.angles_rad), [360.0]])
        left.stairs(
            values,
            edges,
            baseline=None,
            color=shade,
            lw=1.1,
            zorder=3,
            label=f"pitch {_NAMES[row.pitch_m]} m",
        )
    left.set_xlim(0.0, 180.0)
    left.set_xticks(np.arange(0, 181, 45))
    left.set_xlabel("angle (degrees)")
    left.set_ylabel("torque / peak of the surface")
    left.legend(frameon=False, fontsize=8, loc="upper right")
    pitches, errors = [row.pitch_m for row in rows], [row.rms for row in rows]
    right.plot(pitches, errors, "o-", color=INK, lw=1.4, ms=5)
    for row in rows:
        right.annotate(
            f"{row.rms:.4f}", (row.pitch_m, row.rms), xytext=(7, -3), textcoords="offset points", fontsize=8
        )
    right.set_xscale("log", base=2)
    right.set_yscale("log")
    right.set_xticks(pitches, [_NAMES[pitch] for pitch in pitches])
    right.set_xlim(0.1, 1.9)
    right.set_xlabel("pitch (m)")
    right.set_ylabel("rms error / peak")
    return figure
