"""A parcel on an array of cells as MuJoCo models it: a free box on small spheres whose surfaces move.

A cell is a sphere that stands still and has a surface velocity (``geom/surfacevel``, MuJoCo 3.11); its top is in the
plane on which the parcel lies. The parcel's centre of mass is in that plane, too: the plant knows no height, and with
one friction would shift loads. Friction is Coulomb's with a circular cone.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import cos, sin, sqrt

import mujoco
import numpy as np
from numpy.typing import NDArray

from deploy.runs.field_simulation import field_speeds
from deploy.scenes.scene import Scene
from plant.array import CellArray

Floats = NDArray[np.float64]

MU = 0.3
COULOMB = (f'friction={{law="coulomb",coefficient={MU},contact="isotropic"}}', 'solver={name="implicit"}')
SAMPLE_S = 0.02
SETTLE_S = 0.5
"""On wheels that stand, before each run: the parcel sinks into the contacts, where it is to stay."""
_THICK_M = 0.02
_THROWN_M = 0.05
"""A parcel this far above or below the wheels no longer rides on them."""
_BAD = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


@dataclass(frozen=True)
class Contact:
    """How contacts are set.

    Attributes:
        title: in tables.
        cone: ``pyramidal`` or ``elliptic``.
        impratio: how much stiffer friction is than what holds the parcel up.
        noslip: iterations of the pass that takes slow slip away.
        radius_m: of the spheres; a cell counts as soon as its sphere touches the edge of the box.
        solref: time constant over the timestep, and damping ratio, of the constraint; None: MuJoCo's own.
        solimp: impedance, constant; None: MuJoCo's own.
        sag_m: instead of the last two, how far the parcel sinks in, on linear springs; None: not so.
        slip_per_s: with ``sag_m``, at what rate friction takes slip away.
    """

    title: str
    cone: str = "pyramidal"
    impratio: float = 1.0
    noslip: int = 0
    radius_m: float = 0.01
    solref: tuple[float, float] | None = None
    solimp: float | None = None
    sag_m: float | None = None
    slip_per_s: float = 1600.0

    def attributes(self, timestep_s: float, mass_kg: float, gravity_m_s2: float, cells: int) -> str:
        """Of every contact, in MJCF."""
        if self.sag_m is not None:
            return self._springs(self.sag_m, mass_kg, gravity_m_s2, cells)
        found = ""
        if self.solref is not None:
            found += f' solref="{self.solref[0] * timestep_s} {self.solref[1]}"'
        if self.solimp is not None:
            found += f' solimp="{self.solimp} {self.solimp} 0.001"'
        return found

    def _springs(self, sag_m: float, mass_kg: float, gravity_m_s2: float, cells: int) -> str:
        """An impedance so low that each contact is a spring and a damper, whatever the others do.

        MuJoCo's contact force is ``(a_ref - a) / R`` with ``R = (1 - d) / d`` over the mass; for a small d the parcel's
        acceleration ``a`` no longer matters, and ``a_ref = -b v - k r``.
        """
        d = 1e-4
        r = (1.0 - d) / d / mass_kg
        rate = sqrt(gravity_m_s2 / sag_m)
        stiffness, damping = r * mass_kg * rate**2 / cells, 2.0 * r * mass_kg * rate / cells
        return (
            f' solref="{-stiffness * d} {-damping * d}" solimp="{d} {d} 0.001"'
            f' solreffriction="{2.0 / (d * self.slip_per_s)} 1"'
        )


CONTACTS = (
    Contact("as it comes"),
    Contact("noslip", cone="elliptic", noslip=20),
    Contact("stiff", cone="elliptic", impratio=100.0, solref=(2.0, 1.0), solimp=0.99),
    Contact("springs", cone="elliptic", impratio=1000.0, radius_m=1e-3, sag_m=1e-5),
)


@dataclass(frozen=True)
class Course:
    """A run.

    Attributes:
        state: ``(T, 3)`` x, y and angle every ``SAMPLE_S``.
        spent_s: processor time a simulated second.
        touching: ``(T,)`` how many cells touch the parcel.
        loads_n: ``(n,)`` on every cell, before the wheels begin to turn.
        failed: whether the parcel was thrown off, or MuJoCo warned of a state that is no number and began anew.
    """

    state: Floats
    spent_s: float
    touching: NDArray[np.int64]
    loads_n: Floats
    failed: bool


def speeds_of(scene: Scene) -> Floats:
    """``(n, 2)`` of the wheels, m/s."""
    return field_speeds(scene, CellArray(scene.array).positions_m)


def build(
    scene: Scene, speeds: Floats, friction: float, timestep_s: float, contact: Contact, cells: int
) -> mujoco.MjModel:
    """The scene's array and first parcel.

    Args:
        scene: array, parcel and gravity.
        speeds: ``(n, 2)`` of the surfaces, m/s.
        friction: Coulomb's coefficient.
        timestep_s: MuJoCo's.
        contact: settings.
        cells: that carry the parcel, about.
    """
    parcel = scene.parcels[0]
    assert parcel.size_m is not None
    (length, width), mass, thick = parcel.size_m, parcel.mass_kg, _THICK_M / 2.0
    extra = contact.attributes(timestep_s, mass, scene.gravity_m_s2, cells)
    springs = contact.sag_m is not None  # what only a pair can be given
    own = "" if springs else f'friction="{friction} 0 0" condim="3"{extra}'
    spheres = [
        f'<geom name="cell{i}" type="sphere" size="{contact.radius_m}" pos="{x!r} {y!r} {-contact.radius_m}" '
        f'contype="{0 if springs else 1}" conaffinity="0" surfacevel="{vx!r} {vy!r} 0 0 0 0" {own}/>'
        for i, ((x, y), (vx, vy)) in enumerate(
            zip(CellArray(scene.array).positions_m.tolist(), speeds.tolist(), strict=True)
        )
    ]
    pairs = [
        f'<pair geom1="cell{i}" geom2="box" condim="3" friction="{friction} {friction} 0 0 0"{extra}/>'
        for i in range(len(spheres) if springs else 0)
    ]
    inertia = (mass * (side**2 + thick**2) / 12.0 for side in (width, length))
    upright = mass * (length**2 + width**2) / 12.0
    half, (x, y) = parcel.angle_rad / 2.0, parcel.position_m
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
<option timestep="{timestep_s}" gravity="0 0 {-scene.gravity_m_s2}"
cone="{contact.cone}" impratio="{contact.impratio}" noslip_iterations="{contact.noslip}"/>
<worldbody>{"".join(spheres)}
<body pos="{x} {y} 0" quat="{cos(half)!r} 0 0 {sin(half)!r}"><freejoint/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="{" ".join(map(repr, inertia))} {upright!r}"/>
<geom name="box" type="box" size="{length / 2} {width / 2} {thick}" pos="0 0 {thick}"
contype="0" conaffinity="{0 if springs else 1}" {own}/>
</body></worldbody><contact>{"".join(pairs)}</contact></mujoco>""")


def run(
    scene: Scene,
    speeds: Floats,
    friction: float,
    timestep_s: float,
    contact: Contact,
    seconds: float,
    cells: int = 17,
) -> Course:
    """Let the parcel settle where it starts, on wheels that stand; then turn the wheels, and look at times."""
    model = build(scene, speeds, friction, timestep_s, contact, cells)
    data = mujoco.MjData(model)
    start = data.qpos.copy()
    moving = model.geom_surfacevel.copy()
    model.geom_surfacevel[:] = 0.0
    mujoco.mj_step(model, data, nstep=round(SETTLE_S / timestep_s))
    loads = _loads(model, data)
    data.qpos[:2], data.qvel[:] = start[:2], 0.0
    data.qvel[:2], data.qvel[5] = scene.parcels[0].velocity_m_s, scene.parcels[0].angular_velocity_rad_s
    model.geom_surfacevel[:] = moving
    samples, steps = round(seconds / SAMPLE_S), round(SAMPLE_S / timestep_s)
    state, touching = np.empty((samples + 1, 3)), np.zeros(samples + 1, dtype=np.int64)
    state[0] = _pose(data)
    touching[0] = data.ncon
    spent, height = 0.0, 0.0
    for k in range(1, samples + 1):
        begun = time.process_time()
        mujoco.mj_step(model, data, nstep=steps)
        spent += time.process_time() - begun
        state[k], touching[k] = _pose(data), data.ncon
        height = max(height, abs(float(data.qpos[2])))
    state[:, 2] = np.unwrap(state[:, 2])
    failed = height > _THROWN_M or any(data.warning[kind].number for kind in _BAD)
    return Course(state, spent / seconds, touching, loads, failed)


def _pose(data: mujoco.MjData) -> tuple[float, float, float]:
    w, _, _, z = data.qpos[3:7]
    return float(data.qpos[0]), float(data.qpos[1]), float(2.0 * np.arctan2(z, w))


def _loads(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """``(n,)`` normal forces on the cells."""
    loads, force = np.zeros(model.ngeom - 1), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        loads[min(data.contact[i].geom)] += force[0]
    return loads
