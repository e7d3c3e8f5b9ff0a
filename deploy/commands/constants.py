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

_NOTHING = 1e-12
"""In SI units, of forces, lengths and rates as they are here."""

ParcelOption = Annotated[int, typer.Option("--parcel", metavar="N", help="Which parcel, counted from 0.")]


def constants(
    scene: SceneArgument, *, sets: SetOption = None, parcel: ParcelOption = 0, as_json: JsonOption = False
) -> None:
    """Print the constants of motion of a parcel where the scene starts it (eqs. 18 and 23 of the paper).

    While the same cells carry the parcel, the force on it is affine in its position, and the torque does not depend
    on its angle. Wheel speeds are those of the scene's velocity field.

    Another pose is another start:

      [cyan]mdms constants elliptic --set parcels.0.position_m=[0.1,0][/cyan]
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

    rows = (
        (
            "k_s",
            f"{_vector(motion.k_s_n_per_m[0])}, {_vector(motion.k_s_n_per_m[1])} N/m",
            "rows of the stiffness",
        ),
        ("f0", f"{_vector(motion.f0_n)} N", "force at the origin"),
        ("mu W", f"{_number(motion.damping_n_s_per_m)} N s/m", "damping in translation"),
        ("tau0", f"{_number(motion.tau0_n_m)} N m", "torque at the pose"),
        ("k_tau", f"{_vector(motion.k_tau_n)} N", "its gradient in position"),
        ("d", f"{_number(motion.d_n_m_s)} N m s", "damping in rotation"),
        ("equilibrium", _equilibrium(motion), "where the force vanishes"),
        ("eigenvalues", f"{_rates(motion.eigenvalues_per_s)} 1/s", "of the translation"),
        ("tau0 / I", f"{_number(motion.angular_acceleration_rad_s2)} rad/s²", "acceleration from rest"),
    )
    pose = scene.parcels[parcel]
    console = Console(highlight=False)
    console.print(
        f"scene {scene.name}, parcel {parcel} at {_vector(pose.position_m)} m, {pose.angle_rad:.6g} rad, "
        f"carried by {len(motion.supports)} cells\n"
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


def _number(value: float) -> str:
    """Four digits, all of them with ``--json``; what rounding leaves of nothing is nothing."""
    return "0" if abs(value) < _NOTHING else f"{value:.4g}"


def _vector(values: Any) -> str:
    return f"({', '.join(_number(value) for value in values)})"


def _equilibrium(motion: ConstantsOfMotion) -> str:
    if motion.equilibrium_m is None:
        return "none: k_s is singular"
    there = "same cells" if motion.equilibrium_inside else "other cells"
    return f"{_vector(motion.equilibrium_m)} m, on {there}"


def _rates(values: Any) -> str:
    """Complex numbers, conjugate ones as a pair."""
    words: list[str] = []
    for value in values:
        real, imaginary = _number(value.real), _number(abs(value.imag))
        words.append(real if imaginary == "0" else f"{real} ± {imaginary}i")
    return ", ".join(dict.fromkeys(words))
