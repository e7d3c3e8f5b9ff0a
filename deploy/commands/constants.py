"""``mdms constants``: what the wheels do to a parcel at a pose, as long as the same cells carry it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deploy.commands.options import JsonOption, SceneArgument, SetOption, load_scene
from deploy.errors import InputError

if TYPE_CHECKING:
    from deploy.scene import Scene
    from plant.constants import ConstantsOfMotion

ParcelOption = Annotated[int, typer.Option("--parcel", metavar="N", help="Which parcel, counted from 0.")]


def constants(
    scene: SceneArgument, *, sets: SetOption = None, parcel: ParcelOption = 0, as_json: JsonOption = False
) -> None:
    """Print the constants of motion of a parcel where the scene starts it (eqs. 18 and 23 of the paper).

    While the same cells carry the parcel, the force on it is affine in its position, and the torque does not depend
    on its angle. Wheel speeds are those of the scene's velocity field.

    Another pose is another start:

      [cyan]mdms constants elliptic --set parcels.0.position_m=[0.1,0] --set parcels.0.angle_rad=0[/cyan]
    """
    found = load_scene(scene, sets)
    motion = _constants(found, parcel)
    if as_json:
        print(
            json.dumps({"scene": found.name, "parcel": parcel, **_plain(motion)}, indent=2, allow_nan=False)
        )
    else:
        _print(found, parcel, motion)


def _constants(scene: Scene, parcel: int) -> ConstantsOfMotion:
    from deploy.simulate import field_speeds
    from plant.array import CellArray
    from plant.constants import constants_of_motion
    from plant.errors import PlantError

    if not 0 <= parcel < len(scene.parcels):
        has = f"parcels 0..{len(scene.parcels) - 1}" if scene.parcels else "no parcels"
        raise InputError(f"scene {scene.name}: --parcel {parcel}: the scene has {has}")
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

    def vector(values: Any) -> str:
        return f"({', '.join(f'{value:.6g}' for value in values)})"

    place = motion.equilibrium_m
    if place is None:
        where = "none: k_s is singular"
    else:
        there = "the same cells carry the parcel there" if motion.equilibrium_inside else "on other cells"
        where = f"{vector(place)} m, {there}"
    rows = (
        (
            "k_s",
            f"{vector(motion.k_s_n_per_m[0])}, {vector(motion.k_s_n_per_m[1])} N/m",
            "rows of the stiffness",
        ),
        ("f0", f"{vector(motion.f0_n)} N", "force with the parcel at the origin"),
        ("mu W", f"{motion.damping_n_s_per_m:.6g} N s/m", "damping of the translation"),
        ("tau0", f"{motion.tau0_n_m:.6g} N m", "torque at the pose"),
        ("k_tau", f"{vector(motion.k_tau_n)} N", "its gradient in position"),
        ("d", f"{motion.d_n_m_s:.6g} N m s", "damping of the rotation"),
        ("equilibrium", where, "where the force vanishes"),
        ("eigenvalues", f"{vector(motion.eigenvalues_per_s)} 1/s", "of the translation"),
        ("tau0 / I", f"{motion.angular_acceleration_rad_s2:.6g} rad/s²", "angular acceleration from rest"),
    )
    pose = scene.parcels[parcel]
    console = Console(highlight=False)
    console.print(
        f"scene {scene.name}, parcel {parcel} at {vector(pose.position_m)} m, {pose.angle_rad:.6g} rad, "
        f"carried by {len(motion.supports)} cells\n"
        "force = f0 + k_s X - mu W U    torque = tau0 + k_tau (X - pose) + ... - d omega\n",
        markup=False,
    )
    table = Table(box=None, pad_edge=False, show_header=False)
    for style in ("cyan", None, "dim"):
        table.add_column(style=style)
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
