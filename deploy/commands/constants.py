"""``mdms constants``: constants of motion of a parcel at a pose, valid while its supports stay the same."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deploy.commands.options import (
    JsonOption,
    ParcelOption,
    SceneArgument,
    SetOption,
    check_parcel,
    load_scene,
    numbers,
)
from deploy.errors import InputError
from deploy.util.formatting import format_point, say, short_number

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from plant.analysis.constants import ConstantsOfMotion

_POSE = "X,Y,DEGREES"
AtOption = Annotated[
    str | None,
    typer.Option(
        "--at",
        metavar=_POSE,
        help="Pose: centre of mass in metres, angle in degrees. Default: the parcel's initial pose in the scene.",
    ),
]


def constants(
    scene: SceneArgument,
    *,
    sets: SetOption = None,
    parcel: ParcelOption = 0,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the constants of motion of a parcel at a pose (eqs. 18 and 23 of the paper).

    While the same cells carry a parcel, the force on the parcel is affine in its position, and the torque does not
    depend on its angle. Wheel speeds come from the scene's velocity field.

    The initial pose of the scene; a pose 0.1 m beside the centre, turned by 30 degrees:

      [cyan]mdms constants elliptic[/cyan]
      [cyan]mdms constants elliptic --at 0.1,0,30[/cyan]
    """
    from deploy.runs.setup import report_warnings

    found = load_scene(scene, sets)
    check_parcel(found, parcel)
    report_warnings(found, say)
    if at is not None:
        found = _posed(found, parcel, at)
    motion = _constants(found, parcel)
    if as_json:
        pose = found.parcels[parcel]
        head = {
            "scene": found.name,
            "parcel": parcel,
            "position_m": list(pose.position_m),
            "angle_rad": pose.angle_rad,
        }
        print(json.dumps({**head, **_plain(motion)}, indent=2, allow_nan=False))
    else:
        _print(found, parcel, motion)


def _posed(scene: Scene, parcel: int, at: str) -> Scene:
    """The scene with the parcel at the pose that ``--at`` gives."""
    x, y, degrees = numbers("--at", at, _POSE)
    parcels = list(scene.parcels)
    pose = {"position_m": (x, y), "angle_rad": math.radians(degrees)}
    parcels[parcel] = parcels[parcel].model_copy(update=pose)
    return scene.model_copy(update={"parcels": tuple(parcels)})


def _constants(scene: Scene, parcel: int) -> ConstantsOfMotion:
    from deploy.runs.field_simulation import field_speeds
    from plant.analysis.constants import constants_of_motion
    from plant.array import CellArray
    from plant.errors import PlantError

    speeds = field_speeds(scene, CellArray(scene.array).positions_m)
    try:
        return constants_of_motion(scene.plant_spec(), parcel, speeds)
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}") from None


def _plain(motion: ConstantsOfMotion) -> dict[str, Any]:
    """In JSON's types; a complex number as ``[real, imaginary]``."""
    place = motion.equilibrium_m
    return {
        "supports": [list(cell) for cell in motion.supports],
        "loads_n": motion.loads_n.tolist(),
        "k_s_n_per_m": motion.k_s_n_per_m.tolist(),
        "f0_n": motion.f0_n.tolist(),
        "damping_n_s_per_m": motion.damping_n_s_per_m,
        "tau0_n_m": motion.tau0_n_m,
        "k_tau_n": motion.k_tau_n.tolist(),
        "d_n_m_s": motion.d_n_m_s,
        "equilibrium_m": None if place is None else place.tolist(),
        "equilibrium_inside": motion.equilibrium_inside,
        "eigenvalues_per_s": [[float(rate.real), float(rate.imag)] for rate in motion.eigenvalues_per_s],
        "angular_acceleration_rad_s2": motion.angular_acceleration_rad_s2,
    }


def _print(scene: Scene, parcel: int, motion: ConstantsOfMotion) -> None:
    from rich.console import Console
    from rich.table import Table

    rows = (
        (
            "k_s",
            f"{format_point(motion.k_s_n_per_m[0])}, {format_point(motion.k_s_n_per_m[1])} N/m",
            "rows of the stiffness",
        ),
        ("f0", f"{format_point(motion.f0_n)} N", "force at the origin"),
        ("mu W", f"{short_number(motion.damping_n_s_per_m)} N s/m", "damping in translation"),
        ("tau0", f"{short_number(motion.tau0_n_m)} N m", "torque at the pose"),
        ("k_tau", f"{format_point(motion.k_tau_n)} N", "gradient of the torque"),
        ("d", f"{short_number(motion.d_n_m_s)} N m s", "damping in rotation"),
        ("equilibrium", _equilibrium(motion), "position without force"),
        ("eigenvalues", f"{_rates(motion.eigenvalues_per_s)} 1/s", "of the translation"),
        ("tau0 / I", f"{short_number(motion.angular_acceleration_rad_s2)} rad/s²", "acceleration from rest"),
    )
    pose = scene.parcels[parcel]
    console = Console(highlight=False)
    console.print(
        f"scene {scene.name}, parcel {parcel} at {format_point(pose.position_m)} m, {pose.angle_rad:.6g} rad "
        f"({math.degrees(pose.angle_rad):.5g}°), carried by {len(motion.supports)} cells\n"
        "force = f0 + k_s X - mu W U    torque = tau0 + k_tau (X - pose) + ... - d omega\n",
        markup=False,
    )
    table = Table(box=None, pad_edge=False, show_header=False)
    for style in ("cyan", None, "dim"):
        table.add_column(style=style, no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)
    loads = Table(box=None, pad_edge=False)
    loads.add_column("cell", style="cyan")
    loads.add_column("load N", justify="right")
    for cell, load in zip(motion.supports, motion.loads_n, strict=True):
        loads.add_row(f"{cell[0]},{cell[1]}", f"{load:.6g}")
    console.print()
    console.print(loads)


def _equilibrium(motion: ConstantsOfMotion) -> str:
    if motion.equilibrium_m is None:
        return "none: k_s is singular"
    there = "same cells" if motion.equilibrium_inside else "other cells"
    return f"{format_point(motion.equilibrium_m)} m, on {there}"


def _rates(values: Any) -> str:
    """Complex numbers, conjugate ones as a pair."""
    words: list[str] = []
    for value in values:
        real, imaginary = short_number(value.real), short_number(abs(value.imag))
        words.append(real if imaginary == "0" else f"{real} ± {imaginary}i")
    return ", ".join(dict.fromkeys(words))
