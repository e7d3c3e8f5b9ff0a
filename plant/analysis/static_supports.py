"""Load-carrying cells of a parcel at rest, from the solver's own computation, without motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.friction.law import Traction
from plant.kernels.common import layout
from plant.parcel_spec import ParcelSpec
from plant.solver_specs import ExactSpec
from plant.solvers.exact import Exact
from plant.wheels import Floats

if TYPE_CHECKING:
    from plant.array import CellArray

Cells = NDArray[np.intp]


def footprint(parcel: ParcelSpec) -> Floats:
    """``(v, 2)`` corners of a parcel's bottom about its centre of mass, in its axes, counter-clockwise."""
    centre = parcel.centre_of_mass_m or geometry.centroid(parcel.polygon())
    return geometry.counter_clockwise(parcel.polygon()) - np.array(centre)


def moved(parcel: ParcelSpec, place_m: Floats) -> ParcelSpec:
    """The parcel with its centre of mass at ``(2,)`` m."""
    return parcel.model_copy(update={"position_m": (float(place_m[0]), float(place_m[1]))})


@final
class StaticSupports:
    """One parcel, alone on the array and at rest, at its start pose until other cells are put below it.

    Args:
        array: the cells.
        parcel: footprint and start pose.

    Attributes:
        inertia_kg_m2: about the centre of mass.
    """

    def __init__(self, array: CellArray, parcel: ParcelSpec) -> None:
        # loads depend on no law of traction: any does
        self._solver = Exact(array, (parcel,), Traction(push_per_load=1.0), 1.0, 0.0, ExactSpec())
        self._parcel = self._solver.parcels[0]
        self._driven: Floats = np.ones(len(array))
        self.inertia_kg_m2: float = parcel.mass_kg / float(self._parcel.par[layout.MASS_OVER_INERTIA])

    def set_cells(self, under: Cells) -> None:
        """Turn the parcel to where the cells ``under``, and no others, are below it: loads depend on no more."""
        count = len(under)
        self._parcel.mem[:count] = 0  # all of them pressed, as ever: what was lifted before is no first guess
        self._parcel.mem[:count, layout.CELL] = under
        self._parcel.ctl[layout.N_MEMBERS] = count

    def supports(self) -> Cells:
        """The cells that carry the parcel, ascending; none where it doesn't stand."""
        count = self._parcel.ctl[layout.N_MEMBERS]
        if count == 0 or not self._solver.find_supports(0, self._driven):
            return np.zeros(0, dtype=np.intp)
        members = self._parcel.mem[:count]
        return np.sort(members[members[:, layout.MARK] == layout.ACTIVE, layout.CELL]).astype(np.intp)
