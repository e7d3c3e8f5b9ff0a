"""``mdms orientations``: rest orientations of parcels in a field, by size."""

from __future__ import annotations

import json
import math
from pathlib import Path
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
from deploy.util.formatting import say
from deploy.util.output_lock import locked_folder

if TYPE_CHECKING:
    from deploy.studies.orientations.study import OrientationStudy, SizeMap
    from plant.analysis.orientations import TorqueProfile
    from plant.wheels import Floats

_POINT = "X,Y"
_SIZES = "LMIN:LMAX:N,BMIN:BMAX:N"

_MOST = 1000
"""Lengths, or widths, of one map: a million sizes take a quarter of an hour."""
AtOption = Annotated[
    str | None,
    typer.Option(
        "--at",
        metavar=_POINT,
        help="Position of the centre of mass, m. Default: the position at which the field brings it to rest.",
    ),
]
SizesOption = Annotated[
    str | None,
    typer.Option(
        "--sizes",
        metavar=_SIZES,
        help="Instead of the scene's parcel: rectangles of N lengths and N widths, m.",
    ),
]

OutputOption = Annotated[
    Path | None,
    typer.Option("--output", metavar="DIR", help="Folder for the plot. Default: no plot."),
]


def orientations(
    scene: SceneArgument,
    *,
    sets: SetOption = None,
    parcel: ParcelOption = 0,
    at: AtOption = None,
    sizes: SizesOption = None,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the angles at which a parcel comes to rest in a velocity field, with its centre of mass at rest.

    Between the angles at which a cell crosses the parcel's edge the torque is constant. An angle at which the torque
    falls through zero attracts: the torque turns the parcel back from both sides. An interval without torque can
    attract too. Angles come from the geometry and are exact. --output DIR also writes a plot.

    A parcel of the scene; rectangles of 60 by 60 sizes instead:

      [cyan]mdms orientations elliptic --output study[/cyan]
      [cyan]mdms orientations elliptic --sizes 0.3:0.8:60,0.2:0.5:60 --output study[/cyan]
    """
    from deploy.runs.setup import report_warnings
    from deploy.studies.orientations.study import study
    from deploy.util.signals import Interruption

    found = load_scene(scene, sets)
    check_parcel(found, parcel)
    place = None if at is None else numbers("--at", at, _POINT)
    ranges = None if sizes is None else _ranges(sizes)
    interruption = Interruption()
    with interruption.handling(last=True), interruption.interruptible():
        report_warnings(found, say)
        orientation_study = study(found, parcel, place)
        with locked_folder(output, say) as folder:
            if ranges is None:
                _one(orientation_study, folder, as_json=as_json)
            else:
                _many(orientation_study, ranges, folder, as_json=as_json)


def _one(orientation_study: OrientationStudy, folder: Path | None, *, as_json: bool) -> None:
    profile = orientation_study.profile()
    picture = None
    if folder is not None:
        from deploy.studies.orientations.plots import FILE_NAME, draw_orientations

        picture = folder / FILE_NAME
        draw_orientations(orientation_study, profile, picture)
    if as_json:
        found = {**_head(orientation_study), **_plain(profile), "picture": picture and str(picture)}
        print(json.dumps(found, indent=2, allow_nan=False))
        return
    from deploy.studies.orientations.console import print_orientations

    print_orientations(orientation_study, profile)
    if picture:
        print(f"\n{picture}")


def _many(
    orientation_study: OrientationStudy, ranges: tuple[Floats, Floats], folder: Path | None, *, as_json: bool
) -> None:
    from deploy.studies.orientations.study import size_map

    sizes = size_map(orientation_study, *ranges)
    picture = None
    if folder is not None:
        from deploy.studies.orientations.plots import SIZES_FILE_NAME, draw_sizes

        picture = folder / SIZES_FILE_NAME
        draw_sizes(orientation_study, sizes, picture)
    if as_json:
        found = {**_head(orientation_study), "rows": _rows(sizes), "picture": picture and str(picture)}
        print(json.dumps(found, indent=2, allow_nan=False))
        return
    from deploy.studies.orientations.console import print_sizes

    print_sizes(orientation_study, sizes)
    if picture:
        print(f"\n{picture}")


def _ranges(text: str) -> tuple[Floats, Floats]:
    """Lengths and widths that ``--sizes`` asks for."""
    import numpy as np

    try:
        found: list[Floats] = []
        for side in text.split(","):
            low, high, count = side.split(":")
            if int(count) > _MOST:
                raise InputError(f"--sizes {text}: {int(count):,} lengths or widths; at most {_MOST:,}")
            found.append(np.linspace(float(low), float(high), int(count)))
        lengths, widths = found
    except ValueError:
        raise InputError(
            f"--sizes {text}: must be {_SIZES}: bounds in metres, and a number of sizes"
        ) from None
    for values in found:
        if not len(values) or not np.all(np.isfinite(values)) or np.any(values <= 0.0):
            raise InputError(f"--sizes {text}: lengths and widths must be > 0, and one at least of each")
    return lengths, widths


def _head(orientation_study: OrientationStudy) -> dict[str, Any]:
    return {
        "scene": orientation_study.scene.name,
        "parcel": orientation_study.parcel,
        "centre_m": orientation_study.centre_m.tolist(),
    }


def _plain(profile: TorqueProfile) -> dict[str, Any]:
    """In JSON's types; where the parcel doesn't stand there is no torque."""
    return {
        "angles_rad": profile.angles_rad.tolist(),
        "torque_n_m": [None if math.isnan(torque) else torque for torque in profile.torque_n_m.tolist()],
        "largest_force_n": profile.largest_force_n(),
        "supports": profile.supports.tolist(),
        "orientations": [
            {
                "low_rad": one.low_rad,
                "high_rad": one.high_rad,
                "nature": one.nature,
                "before_n_m": one.before_n_m,
                "after_n_m": one.after_n_m,
            }
            for one in profile.orientations()
        ],
    }


def _rows(sizes: SizeMap) -> list[dict[str, Any]]:
    nearest = sizes.nearest_rad()
    return [
        {
            "length_m": float(length),
            "width_m": float(width),
            "stands": stable is not None,
            "stable_rad": [[one.low_rad, one.high_rad] for one in stable or ()],
            "nearest_rad": None if math.isnan(nearest[b, a]) else float(nearest[b, a]),
        }
        for b, width in enumerate(sizes.widths_m)
        for a, length in enumerate(sizes.lengths_m)
        for stable in (sizes.stable[b][a],)
    ]
