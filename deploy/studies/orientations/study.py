"""Rest orientations of rectangles of many sizes in one field."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.runs.field_simulation import field_speeds
from deploy.util.progress import LINE_S
from plant.analysis.equilibrium import continuous_torque, equilibrium_point, linear_field, loaded_moments
from plant.analysis.torque_profile import TorqueProfiler
from plant.array import CellArray
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from plant.analysis.orientations import Orientation, TorqueProfile
    from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True)
class OrientationStudy:
    """Parcel of a scene with the fixed point of its centre of mass.

    Attributes:
        scene: The scene.
        parcel: Which of its parcels.
        array: Its cells.
        speeds_m_s: ``(n, 2)`` of their wheels.
        table: The field to turn parcels on.
        centre_m: ``(2,)`` the point.
    """

    scene: Scene
    parcel: int
    array: CellArray
    speeds_m_s: Floats
    table: TorqueProfiler
    centre_m: Floats

    def profile(self) -> TorqueProfile:
        """Torque against angle.

        Raises:
            InputError: The parcel stands at that point at no angle.
        """
        try:
            return self.table.profile(self.scene.parcels[self.parcel], self.centre_m)
        except PlantError as error:
            raise InputError(f"scene {self.scene.name}: {error}") from None

    def continuous(self, angles_rad: Floats) -> Floats | None:
        """Torque ``(k,)``, N m, on a continuous surface; None where the field isn't linear, or loads would pull."""
        field = linear_field(self.array.positions_m, self.speeds_m_s)
        parcel = self.scene.parcels[self.parcel]
        moments = loaded_moments(parcel)
        if field is None or moments is None:
            return None
        return self.table.drag_n_s_per_m(parcel) * continuous_torque(angles_rad, field, moments)


def study(scene: Scene, parcel: int, centre_m: Sequence[float] | None) -> OrientationStudy:
    """Prepare the study of a parcel.

    Args:
        scene: Its firmware must be ``velocity_field``.
        parcel: Which parcel; must exist.
        centre_m: Where its centre of mass is; None: where the field brings it to rest.

    Raises:
        InputError: The firmware or the law is another, or the field brings the parcel to rest at no point.
    """
    array = CellArray(scene.array)
    speeds = field_speeds(scene, array.positions_m)
    spec = scene.plant_spec()
    try:
        table = TorqueProfiler(spec, speeds)
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}") from None
    try:
        place = equilibrium_point(spec, parcel, speeds) if centre_m is None else np.array(centre_m)
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}: give a point with --at X,Y") from None
    return OrientationStudy(scene, parcel, array, speeds, table, place)


@final
@dataclass(frozen=True, slots=True)
class SizeMap:
    """Stable orientations over sizes.

    Attributes:
        lengths_m: ``(a,)`` along the parcel's x.
        widths_m: ``(b,)`` along its y.
        stable: ``b`` rows of ``a``: the attracting orientations of each size; None where it stands at no angle.
    """

    lengths_m: Floats
    widths_m: Floats
    stable: tuple[tuple[tuple[Orientation, ...] | None, ...], ...]

    def counts(self) -> NDArray[np.int64]:
        """``(b, a)``: how many stable orientations a turn; -1 where the parcel stands at no angle."""
        return np.array([[-1 if one is None else len(one) for one in row] for row in self.stable])

    def nearest_rad(self) -> Floats:
        """``(b, a)``: how far the stable orientation nearest to 0 is from it; NaN where there is none."""
        return np.array(
            [
                [min((one.away_from(0.0) for one in each or ()), default=np.nan) for each in row]
                for row in self.stable
            ]
        )


def size_map(study: OrientationStudy, lengths_m: Floats, widths_m: Floats) -> SizeMap:
    """Turn a rectangle of every size, at the study's point and of its parcel's mass; reports its progress on stderr.

    Args:
        study: Of a parcel whose footprint is a rectangle.
        lengths_m: ``(a,)``, > 0.
        widths_m: ``(b,)``, > 0.

    Raises:
        InputError: The parcel is a polygon.
    """
    parcel = study.scene.parcels[study.parcel]
    if parcel.size_m is None:
        raise InputError(
            f"scene {study.scene.name}: parcels[{study.parcel}].vertices_m: --sizes needs a parcel with size_m"
        )

    def stable(length: float, width: float) -> tuple[Orientation, ...] | None:
        try:
            return study.table.profile(
                parcel.model_copy(update={"size_m": (length, width)}), study.centre_m
            ).stable()
        except PlantError:
            return None

    rows = [
        tuple(stable(length, width) for length in lengths_m.tolist()) for width in _shown(widths_m.tolist())
    ]
    return SizeMap(lengths_m, widths_m, tuple(rows))


def _shown(widths: list[float]) -> Generator[float]:
    """Each in turn, while stderr shows how many are done."""
    if sys.stderr.isatty():
        yield from _bar(widths)
        return
    said = time.monotonic()
    for done, width in enumerate(widths):
        if time.monotonic() - said > LINE_S:
            said = time.monotonic()
            sys.stderr.write(f"mdms: {done} of {len(widths)} widths\n")
            sys.stderr.flush()
        yield width


def _bar(widths: list[float]) -> Iterable[float]:
    from rich.console import Console
    from rich.progress import track

    return track(widths, description="widths", console=Console(stderr=True), transient=True)
