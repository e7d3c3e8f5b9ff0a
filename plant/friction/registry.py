"""Every traction law there is: a new one is a file and a line here."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from plant.friction.coulomb import Coulomb
from plant.friction.coulomb_sliding import CoulombSliding
from plant.friction.rolling import Rolling
from plant.friction.stick_slip import StickSlip
from plant.friction.viscous import Viscous
from plant.tagged import tagged

FrictionSpec = Annotated[
    Annotated[
        Viscous  # eq. 14, the default
        | CoulombSliding  # eq. 24
        | Coulomb  # set-valued
        | Rolling  # eq. 27
        | StickSlip,  # ACC 1998
        Field(discriminator="law"),
    ],
    BeforeValidator(tagged("law", "viscous")),
]
"""Any law, distinguished by its ``law``."""
