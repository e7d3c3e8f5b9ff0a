"""Terminal output of rest orientations, of one parcel or of many sizes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from deploy.util.formatting import format_point, plural, short_number
from plant.analysis.crossings import TURN

if TYPE_CHECKING:
    from deploy.studies.orientations.study import OrientationStudy, SizeMap
    from plant.analysis.orientations import Orientation, TorqueProfile
    from plant.wheels import Floats


def angles(one: Orientation) -> str:
    """``84.4626``, or ``355.19 to 4.81``, degrees."""
    if one.high_rad - one.low_rad >= TURN:
        return "all"
    low = _degrees(one.low_rad)
    return f"{low} to {_degrees(one.high_rad)}" if one.is_interval else low


def print_orientations(study: OrientationStudy, profile: TorqueProfile) -> None:
    """Print a parcel's rest orientations and the net force at the worst angle."""
    console = Console(highlight=False)
    changes = plural(len(profile.angles_rad), "angle")
    console.print(
        f"scene {study.scene.name}, parcel {study.parcel}, centre of mass at {format_point(profile.centre_m)} m; "
        f"its supports change at {changes} a turn",
        markup=False,
    )
    found = profile.orientations()
    if found:
        console.print()
        console.print(_table(found))
    else:
        console.print("The torque never vanishes and never changes its sign: the parcel never stops turning.")
    if not np.all(np.isfinite(profile.torque_n_m)):
        console.print("\nAt some angles the parcel tips.")
    force = profile.largest_force_n()
    if force > 0.0:
        console.print(
            f"\nThe point is not an equilibrium at every angle: up to {short_number(force)} N pull the parcel aside, "
            "and the parcel may come to rest at slightly different angles."
        )


def _table(found: tuple[Orientation, ...]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("degrees", style="cyan", no_wrap=True)
    table.add_column("")
    table.add_column("stable")
    for heading in ("torque below, N m", "above"):
        table.add_column(heading, justify="right")
    for one in found:
        what = f"{one.nature} {'interval' if one.is_interval else 'angle'}"
        beside = (
            "–" if torque is None else short_number(torque) for torque in (one.before_n_m, one.after_n_m)
        )
        table.add_row(angles(one), what, "yes" if one.stable else "no", *beside)
    return table


def print_sizes(study: OrientationStudy, sizes: SizeMap) -> None:
    """Print how many sizes have how many stable orientations."""
    console = Console(highlight=False)
    console.print(
        f"scene {study.scene.name}: {sizes.counts().size:,} sizes, {_span(sizes.lengths_m)} m long and "
        f"{_span(sizes.widths_m)} m wide, centre of mass at {format_point(study.centre_m)} m\n",
        markup=False,
    )
    table = Table(box=None, pad_edge=False)
    table.add_column("stable orientations a turn", style="cyan")
    table.add_column("sizes", justify="right")
    numbers, how_often = np.unique(sizes.counts(), return_counts=True)
    for number, often in zip(numbers.tolist(), how_often.tolist(), strict=True):
        table.add_row("stands at no angle" if number < 0 else str(number), f"{often:,}")
    console.print(table)


def _span(values: Floats) -> str:
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"


def _degrees(angle_rad: float) -> str:
    return f"{round(math.degrees(angle_rad), 4) % 360.0:.4f}".rstrip("0").rstrip(".")
