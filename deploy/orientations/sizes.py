"""The orientations of rectangles of many sizes in one field: how size decides how a parcel comes to lie."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from deploy.display import LINE_S
from deploy.errors import InputError
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.orientations.study import Study
    from plant.orientations import Orientation
    from plant.wheels import Floats


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


def size_map(study: Study, lengths_m: Floats, widths_m: Floats) -> SizeMap:
    """Turn a rectangle of every size, at the study's point and of its parcel's mass; tells how far it is on stderr.

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
            return study.table.turn(
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
