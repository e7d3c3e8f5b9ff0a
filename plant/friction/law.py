"""Interface of traction laws: one force per wheel and slip, the gradient of a convex potential."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

from bus.spec import Spec


class Traction(NamedTuple):
    """A law as solvers read it, the same for every wheel.

    The force on the parcel along a wheel's axis is ``clamp(b r, -c, +c) + g`` with the slip ``r = s - v``: ``v`` is the
    velocity of the parcel's underside there, ``V`` the surface speed of the wheel, ``N`` the load on its cell, and

        b = stiffness + stiffness_per_load N      N s/m; infinite: any force up to c at r = 0, c sign(r) beyond
        c = limit + limit_per_load N              N
        s = free_speed V                          m/s
        g = push_per_load N sign(V)               N

    and ``viscous r`` is added. Its dissipation potential, of which that force is the gradient in r, is convex: a
    parabola up to ``|b r| = c``, a straight line beyond, plus the parabola of the viscous part.

    Attributes:
        stiffness: N s/m.
        stiffness_per_load: s/m.
        limit: N; may be infinite.
        limit_per_load: dimensionless.
        free_speed: dimensionless: a wheel without load runs at this share of its surface speed.
        push_per_load: dimensionless.
        viscous: N s/m; this part has no limit.
        set_valued: ``b`` is infinite; ``stiffness`` and ``stiffness_per_load`` are not read.
        static_ratio: limit of a wheel that sticks over ``c``, which is that of one that slips; 1 where they are equal.
        isotropic: the two axes of a cell share one limit: ``b r`` is projected on a disc of radius c.
    """

    stiffness: float = 0.0
    stiffness_per_load: float = 0.0
    limit: float = 0.0
    limit_per_load: float = 0.0
    free_speed: float = 1.0
    push_per_load: float = 0.0
    viscous: float = 0.0
    set_valued: bool = False
    static_ratio: float = 1.0
    isotropic: bool = False


class FrictionLaw(Spec):
    """A traction law with its parameters, as a scene gives them.

    A subclass adds ``law: Literal["its_name"]``, its parameters, and a line in ``plant.friction.registry``. Solvers
    know nothing of a law but its ``Traction``.
    """

    @abstractmethod
    def traction(self) -> Traction:
        """The law's coefficients."""

    @property
    def solvers(self) -> tuple[str, ...] | None:
        """Names of the solvers that know these parameters of the law; None: all that solve the law."""
        return None

    @property
    def by_load(self) -> bool:
        """Whether the traction, or the limit of the traction, is in proportion to the load."""
        traction = self.traction()
        return any((traction.stiffness_per_load, traction.limit_per_load, traction.push_per_load))

    @property
    def own_motors(self) -> bool:
        """Whether the law contains the wheels' motors, so that the effect ``motors`` would count them twice."""
        return False
