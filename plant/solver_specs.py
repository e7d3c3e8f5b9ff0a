"""Settings of every solver, as a scene gives them."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field

from bus.spec import Spec
from plant.spec import tagged

Tolerance = Annotated[float, Field(ge=1e-14, le=1e-2, allow_inf_nan=False)]


class ExactSpec(Spec):
    """Event-driven, analytic between events."""

    laws: ClassVar[tuple[str, ...] | None] = ("viscous", "coulomb_sliding", "rolling", "stick_slip")
    """Which laws it solves; None: all."""
    name: Literal["exact"] = "exact"
    tolerance: Tolerance = 1e-9
    """Metres at the footprint, over the run."""
    capture_m: Annotated[float, Field(gt=0, le=1e-2, allow_inf_nan=False)] = 1e-6
    """Chatter below this amplitude is captured."""

    def accuracy(self) -> dict[str, str | float]:
        """Name of the solver, and what its accuracy hangs on."""
        return {"name": self.name, "tolerance": self.tolerance}


class ImplicitSpec(Spec):
    """A convex problem a step, for any law."""

    laws: ClassVar[tuple[str, ...] | None] = None
    """Which laws it solves; None: all."""
    name: Literal["implicit"]
    tolerance: Tolerance = 1e-6
    """Metres at the footprint, a second of motion or a jump of the force; not used where ``step_s`` is given."""
    step_s: Annotated[float, Field(gt=0, le=1.0, allow_inf_nan=False)] | None = None
    """Steps of this length, none longer; left out: steps as the tolerance asks."""

    def accuracy(self) -> dict[str, str | float]:
        """Name of the solver, and what its accuracy hangs on."""
        if self.step_s is not None:
            return {"name": self.name, "step_s": self.step_s}
        return {"name": self.name, "tolerance": self.tolerance}


SolverSpec = Annotated[
    Annotated[ExactSpec | ImplicitSpec, Field(discriminator="name")],
    BeforeValidator(tagged("name", "exact")),
]
"""How the motion is integrated, told apart by ``name``."""
