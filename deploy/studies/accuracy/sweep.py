"""Solvers and settings of a study, from the sweeps in each solver's spec."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final, get_args

from pydantic import ValidationError

from deploy.scenes.scene import Scene
from plant.solver_specs import AnySolver

if TYPE_CHECKING:
    from plant.solver_specs import Sweep

Settings = Mapping[str, Any]
"""A scene's ``[solver]`` table."""


@final
@dataclass(frozen=True, slots=True)
class Trial:
    """One solver at one setting.

    Attributes:
        line: the solver, and which of its sweeps where it has several.
        key: what is swept, ``tolerance`` or ``step_s``.
        value: of it.
        settings: all of the solver's table.
        quick: whether it belongs to a quick study.
        note: what a reader of its error must know; empty: nothing.
        library: function of a library that the solver's adapter calls; empty: kernels of the plant.
    """

    line: str
    key: str
    value: float
    settings: Settings
    quick: bool
    note: str
    library: str

    @property
    def solver(self) -> str:
        """Name of the solver."""
        return str(self.settings["name"])

    @property
    def setting(self) -> str:
        """``tolerance 1e-09``, ``rk4 step_s 0.001``."""
        words = [self.line.removeprefix(self.solver).strip(), self.key, f"{self.value:g}"]
        return " ".join(word for word in words if word and word != "steps")


def solver_names() -> tuple[str, ...]:
    """Every solver there is."""
    return tuple(get_args(spec.model_fields["name"].annotation)[0] for spec in get_args(AnySolver))


def lines(scene: Scene) -> Iterator[tuple[Trial, ...]]:
    """Every sweep of every solver, coarse to fine.

    What the scene sets for its own solver, such as ``capture_m``, stays.
    """
    for spec in get_args(AnySolver):
        (name,) = get_args(spec.model_fields["name"].annotation)
        for sweep in spec.sweeps:
            yield tuple(_trials(scene, name, sweep, spec.library))


def _trials(scene: Scene, name: str, sweep: Sweep, library: str) -> Iterator[Trial]:
    for value in sweep.values:
        settings = _own(scene, name) | {"name": name, **dict(sweep.fixed), sweep.key: value}
        yield Trial(
            f"{name} {sweep.title}".strip(),
            sweep.key,
            value,
            settings,
            value in sweep.quick,
            sweep.note,
            library,
        )


def _own(scene: Scene, name: str) -> dict[str, Any]:
    """Return the scene's solver settings, except for accuracy; empty for another solver."""
    if scene.solver.name != name:
        return {}
    retained = scene.solver.model_dump(exclude_defaults=True, exclude_none=True)
    return {key: value for key, value in retained.items() if key not in ("tolerance", "step_s", "method")}


def with_solver(scene: Scene, settings: Settings, duration_s: float | None = None) -> Scene:
    """The scene under another solver, validated.

    Args:
        scene: with ideal wheels.
        settings: the solver's table.
        duration_s: instead of the scene's.

    Raises:
        ValidationError: the solver doesn't claim the scene.
    """
    table = dict(scene) | {"solver": dict(settings)}
    if duration_s is not None:
        table["duration_s"] = duration_s
    return Scene.model_validate(table).named(scene.name)


def refusal(scene: Scene, settings: Settings) -> str | None:
    """The rule by which a solver doesn't claim a scene, or None."""
    try:
        with_solver(scene, settings)
    except ValidationError as error:
        return "; ".join(f"{settings['name']} {detail['msg']}" for detail in error.errors())
    return None
