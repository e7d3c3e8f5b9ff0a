"""The kernel specialisations that tests use, compiled ahead of the first test, and the check that there are no others.

numba compiles an entry point once for all argument types it is called with, which effects decide (docs/decisions/0008).
Left to tests, a specialisation is compiled in whichever comes first, often in both of two processes at the same time.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

Signatures = Mapping[str, Iterable[str]]
"""Argument types of each entry point, by its name."""

TICK_NS = 1_000_000
PROCESSES = 2
"""Compilers side by side; more would crowd out each other's memory."""


VISCOUS = {"law": "viscous", "coefficient_s_per_m": 0.2}


@dataclass(frozen=True)
class Specialisation:
    """A small run that calls entry points with the types of one combination of solver and effects.

    Attributes:
        name: for people.
        seconds: of processor time that compiling it took; the longest is begun first.
        solver: a scene's ``[solver]`` table.
        effects: a scene's ``[effects]`` table.
        law: a scene's ``[friction]`` table.
        needed: mark of the tests that use it, without which it is not compiled; None: tests of any folder do.
        parcels: what differs from ``PARCEL``, for each.
        ticks: how far it runs, in `TICK_NS`.
        segmented: whether wheels change, or cells read, on the way of a call.
        includes: another's name, all of whose entry points it calls too.
    """

    name: str
    seconds: float
    solver: str
    effects: Mapping[str, Any] = field(default_factory=dict[str, Any])
    law: Mapping[str, Any] = field(default_factory=lambda: VISCOUS)
    needed: str | None = None
    parcels: Sequence[Mapping[str, Any]] = ({},)
    ticks: int = 1
    segmented: bool = False
    includes: str = ""


PARCEL = {"size_m": (0.25, 0.25), "mass_kg": 1.0, "position_m": (0.0, 0.0)}

TOUCHING = ({"position_m": (-0.1251, 0.0), "velocity_m_s": (0.5, 0.0)}, {"position_m": (0.1251, 0.0)})
"""Two parcels, the first about to strike the second and to stay with it."""

UNEVEN = {"uneven_supports": {"stiffness_n_per_m": 3e3, "height_spread_m": 1e-4}}
WIDE = {"contact_width": {"width_m": 0.03}}
ROLLERS = {"roller_impacts": {"spacing_m": 4e-3, "impulse_s": 8e-5}}
UNEQUAL = {"uneven_friction": {"wheel_spread": 0.2}}
TALL = {"load_transfer": {"centre_of_mass_height_m": 0.05}}
DRAGGED = {"roller_drag": {"drag_s_per_m": 0.02}}
LOADED = {"motors": {}, "wheel_load": {"inertia_kg": 0.05}}

STATIC = {"law": "coulomb", "coefficient": 0.3, "static_coefficient": 0.45}

SPECIALISATIONS = (
    Specialisation("exact", 25, "exact"),
    Specialisation("implicit", 39, "implicit"),
    Specialisation("quasi_static", 4, "quasi_static"),
    Specialisation("fixed_step", 3, "fixed_step"),
    Specialisation("motors", 4, "fixed_step", {"motors": {}}),
    Specialisation("exact_segmented", 55, "exact", needed="kernels", segmented=True, includes="exact"),
    Specialisation("implicit_loaded", 31, "implicit", LOADED, needed="kernels"),
    Specialisation(
        "contact", 9, "implicit", {"parcel_contact": {}}, needed="kernels", parcels=TOUCHING, ticks=10
    ),
    Specialisation("spots", 2, "implicit", {"analogue_sensors": {"spot_radius_m": 0.01}}, needed="kernels"),
    Specialisation("implicit_loaded_wide", 16, "implicit", LOADED | WIDE, needed="slow"),
    Specialisation("implicit_loaded_rollers", 33, "implicit", LOADED | ROLLERS, needed="slow"),
    Specialisation("implicit_uneven", 27, "implicit", UNEVEN, needed="slow"),
    Specialisation("implicit_wide", 28, "implicit", WIDE, needed="slow"),
    Specialisation("implicit_uneven_wide", 36, "implicit", UNEVEN | WIDE, needed="slow"),
    Specialisation("implicit_stiction", 27, "implicit", law=STATIC, needed="slow"),
    Specialisation("implicit_unequal", 27, "implicit", UNEQUAL, needed="slow"),
    Specialisation("quasi_static_unequal", 5, "quasi_static", UNEQUAL, needed="slow"),
    Specialisation("fixed_step_unequal", 4, "fixed_step", UNEQUAL, needed="slow"),
    Specialisation("implicit_tall", 16, "implicit", TALL, needed="slow"),
    Specialisation("fixed_step_tall", 4, "fixed_step", TALL, needed="slow"),
    Specialisation("implicit_dragged", 27, "implicit", DRAGGED, needed="slow"),
    Specialisation("implicit_loaded_dragged", 28, "implicit", LOADED | DRAGGED, needed="slow"),
    Specialisation("implicit_rollers", 32, "implicit", ROLLERS, needed="slow"),
    Specialisation("quasi_static_uneven", 5, "quasi_static", UNEVEN, needed="slow"),
    Specialisation("quasi_static_wide", 5, "quasi_static", WIDE, needed="slow"),
    Specialisation("quasi_static_dragged", 5, "quasi_static", DRAGGED, needed="slow"),
    Specialisation("fixed_step_uneven", 4, "fixed_step", UNEVEN, needed="slow"),
    Specialisation("fixed_step_wide", 4, "fixed_step", WIDE, needed="slow"),
    Specialisation("fixed_step_dragged", 4, "fixed_step", DRAGGED, needed="slow"),
)
"""All of them. A new combination of a solver and effects that tests use is an entry here."""


# --- compiling ---------------------------------------------------------------------------------------


def chosen(expression: str) -> list[Specialisation]:
    """Specialisations that the tests of a ``-m`` expression need, in the order in which they are begun."""
    needed = [one for one in SPECIALISATIONS if one.needed is None or f"not {one.needed}" not in expression]
    included = {one.includes for one in needed}
    # those of the slow tier last, so that no other finds in its process what only they need
    return sorted(
        (one for one in needed if one.name not in included),
        key=lambda one: (one.needed == "slow", -one.seconds),
    )


def use(one: Specialisation) -> None:
    """Call the entry points of a specialisation: what isn't on disk is compiled."""
    import numpy as np

    from plant.plant import Plant
    from plant.specs import PlantSpec

    plant = Plant(
        PlantSpec.model_validate(
            {
                "array": {"rows": 4, "columns": 8, "pitch_m": 0.1},
                "parcels": [PARCEL | dict(own) for own in one.parcels],
                "friction": one.law,
                "solver": {"name": one.solver},
                "effects": one.effects,
            }
        )
    )
    if one.segmented:
        plant.warm_up()
    drives = np.zeros((len(plant.array), 2))
    for _ in range(one.ticks):
        plant.advance(drives, plant.time_ns + TICK_NS)


def loaded() -> dict[str, set[str]]:
    """Argument types that the entry points of this process have been compiled or loaded for."""
    return {name: {str(types) for types in point.overloads} for name, point in _entry_points()}


def _entry_points() -> Iterator[tuple[str, Any]]:
    """Functions cached on disk, by the name of the kernel that each is made from; only of modules that are loaded."""
    for module in [
        name for name in sys.modules if name.startswith("plant.kernels.") and name.endswith("entry")
    ]:
        for value in vars(sys.modules[module]).values():
            if hasattr(value, "overloads"):
                yield f"{value.py_func.__module__}.{value.py_func.__qualname__}", value


@cache
def _texts(folder: Path) -> str:
    """Hash of all modules in a folder. Comments count: numba compares the text of a file that holds an entry point."""
    texts = [path.read_bytes() for path in sorted(folder.rglob("*.py"))]
    return hashlib.sha256(b"\0".join(texts)).hexdigest()


def _note(one: Specialisation) -> Path:
    """File that notes the argument types of a specialisation on disk, for the plant as it is, which decides them."""
    from plant.kernels.common.cache import KERNELS, folder

    digest = hashlib.sha256(f"{json.dumps(asdict(one))} {_texts(KERNELS.parent)}".encode())
    return folder()[0] / "used_by_tests" / f"{one.name}-{digest.hexdigest()[:16]}.json"


def lasting() -> bool:
    """Whether another process finds what one compiles."""
    from plant.kernels.common import cache

    return cache.folder()[1]


def missing(needed: Sequence[Specialisation]) -> list[Specialisation]:
    """Specialisations that are not known to be on disk."""
    return [one for one in needed if not _note(one).exists()]


def _compile(one: Specialisation) -> None:
    """Compile in a process of the pool, and note for what."""
    use(one)
    note = _note(one)
    note.parent.mkdir(exist_ok=True)
    note.write_text(json.dumps({name: sorted(types) for name, types in loaded().items()}))


def compile_ahead(needed: Sequence[Specialisation]) -> None:
    """Compile specialisations in the order given, some side by side."""
    # started afresh: a fork of a test's process would have its modules and threads
    with ProcessPoolExecutor(PROCESSES, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(_compile, needed))


# --- checking ----------------------------------------------------------------------------------------


def listed(needed: Sequence[Specialisation]) -> dict[str, list[str]]:
    """Argument types that specialisations on disk are compiled for."""
    types: dict[str, set[str]] = {}
    for one in needed:
        for name, noted in json.loads(_note(one).read_text()).items():
            types.setdefault(name, set()).update(noted)
    return {name: sorted(noted) for name, noted in types.items()}


class Watch:
    """A look for specialisations in use that are not listed, each told once.

    Args:
        known: those listed.
    """

    def __init__(self, known: Signatures) -> None:
        self.known = known
        self._seen = {name: set(types) for name, types in known.items()}
        self._count = 0

    def found(self) -> list[str]:
        """Specialisations that this process has compiled or loaded, and that were neither listed nor told before."""
        count = sum(len(point.overloads) for _, point in _entry_points())
        if count == self._count:
            return []
        self._count = count
        found: list[str] = []
        for name, types in loaded().items():
            seen = self._seen.setdefault(name, set())
            found += [f"{name}: {_summary(one)}; in full: {one}" for one in sorted(types - seen)]
            seen |= types
        return found


def _summary(types: str) -> str:
    """Names of the tuples in argument types: effects have tuples of their own."""
    return ", ".join(dict.fromkeys(re.findall(r"\b([A-Z]\w+)\(", types)))
