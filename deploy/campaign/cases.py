"""The runs of a campaign: a scene for every combination of values, and the undisturbed one beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from bus.fault import CellTarget, FaultSpec
from deploy.campaign.criterion import Criterion, criterion_of
from deploy.campaign.grid import FAULT, Axis, check_size, combinations, seeds_of
from deploy.errors import InputError
from deploy.faults.registry import KINDS
from deploy.overrides import Override
from deploy.scene_files import parse_scene

if TYPE_CHECKING:
    from deploy.campaign.asked import Asked
    from deploy.scene import Scene

_TARGETS = CellTarget.model_fields.keys() - FaultSpec.model_fields.keys()
"""Keys by which a fault that strikes cells says which."""

_MOST_RUNS = 1_000_000
"""Runs of a campaign."""


@final
@dataclass(frozen=True, slots=True)
class Case:
    """One combination of values, whatever the seed.

    Attributes:
        number: Its place in the grid, the last key fastest.
        values: What is varied, by key.
        scene: What runs.
        undisturbed: What that is compared with; None: with nothing.
        criterion: What makes a run of it a success.
        beside: Names the undisturbed scene, seed aside: cases that are compared with the same have the same; empty
            where there is none.
    """

    number: int
    values: dict[str, Any]
    scene: Scene
    undisturbed: Scene | None
    criterion: Criterion
    beside: str = ""

    def undisturbed_key(self, seed: int) -> str:
        """Names the run that the one with this seed is compared with; empty where there is none."""
        return f"{self.beside}-{seed}" if self.beside else ""


@final
@dataclass(frozen=True, slots=True)
class Cases:
    """All that runs.

    Attributes:
        scene: As it is where nothing is varied, without the campaign's fault.
        axes: What is varied.
        seeds: Every case runs with each.
        cases: In the order of the grid.
    """

    scene: Scene
    axes: tuple[Axis, ...]
    seeds: tuple[int, ...]
    cases: tuple[Case, ...]

    @property
    def runs(self) -> int:
        """How many, undisturbed ones not counted."""
        return len(self.cases) * len(self.seeds)

    @property
    def undisturbed_runs(self) -> int:
        """How many of those, each once for all cases that share it."""
        return len({case.beside for case in self.cases} - {""}) * len(self.seeds)


def with_seed(scene: Scene, seed: int) -> Scene:
    """The same scene, left to another chance; what is valid with one seed is with all."""
    return scene.model_copy(update={"seed": seed})


def cases_of(asked: Asked, text: str) -> Cases:
    """Make and validate the scenes of all cases.

    Args:
        asked: The campaign.
        text: TOML of its scene.

    Raises:
        InputError: What was asked makes no sense, or not with this scene; nothing was started.
    """
    everywhere, of_fault = _sets(asked)
    folder = None if asked.folder is None else Path(asked.folder)

    def scene_with(overrides: Sequence[Override]) -> Scene:
        return parse_scene(text, asked.scene, [*everywhere, *overrides], folder)

    plain = scene_with(())
    axes = _axes(asked)
    seeds = seeds_of(asked.seeds, plain.seed)
    check_size(axes, seeds, _MOST_RUNS)
    against = [Override.parse(one, f"--against {one}") for one in asked.against]
    fault = _fault(asked, of_fault, axes)
    place = len(plain.faults)

    def case(number: int, values: tuple[Any, ...]) -> Case:
        varied = [axis.override(value) for axis, value in zip(axes, values, strict=True)]
        own = [one for one in varied if one.path[0] != FAULT]
        faulty = [*fault, *(one for one in varied if one.path[0] == FAULT)]
        undisturbed = scene_with([*own, *against]) if fault or against else None
        scene = scene_with([*own, *(_placed(one, place) for one in faulty)])
        return Case(
            number,
            {axis.key: value for axis, value in zip(axes, values, strict=True)},
            scene,
            undisturbed,
            criterion_of(asked, scene, compared=undisturbed is not None),
            "" if undisturbed is None else sha256(undisturbed.canonical()).hexdigest()[:16],
        )

    return Cases(plain, axes, seeds, tuple(case(*one) for one in enumerate(combinations(axes))))


def _sets(asked: Asked) -> tuple[list[Override], list[Override]]:
    """What ``--set`` changes in the scene, and in the campaign's fault."""
    sets = [Override.parse(text) for text in asked.set]
    if asked.duration_s is not None:
        sets.append(Override(("duration_s",), asked.duration_s, f"--duration {asked.duration_s:g}"))
    everywhere = [one for one in sets if one.path[0] != FAULT]
    of_fault = [one for one in sets if one.path[0] == FAULT]
    for one in of_fault:
        _check_fault(asked, one.path, one.option)
    return everywhere, of_fault


def _axes(asked: Asked) -> tuple[Axis, ...]:
    options = [] if asked.share is None else [(f"{FAULT}.share={asked.share}", f"--share {asked.share}")]
    options += [(one, f"--vary {one}") for one in asked.vary]
    axes = tuple(Axis.parse(text, option) for text, option in options)
    for number, axis in enumerate(axes):
        _check_fault(asked, axis.path, axis.option)
        if axis.path in [other.path for other in axes[:number]]:
            raise InputError(f"{axis.option}: {axis.key} is varied already")
    return axes


def _check_fault(asked: Asked, path: Sequence[str | int], option: str) -> None:
    if path[0] != FAULT:
        return
    if len(path) < 2:
        raise InputError(f"{option}: must name a key of the fault: {FAULT}.KEY")
    if asked.fault is None:
        raise InputError(f"{option}: of which fault? --fault KIND adds one")


def _fault(asked: Asked, more: Sequence[Override], axes: Sequence[Axis]) -> list[Override]:
    """The campaign's fault, without what is varied of it; empty where there is none.

    One that strikes cells, and of which nothing says which, strikes all of them.
    """
    if asked.fault is None:
        for option, given_s in (("--at", asked.at_s or None), ("--until", asked.until_s)):
            if given_s is not None:
                raise InputError(f"{option} {given_s:g}: of which fault? --fault KIND adds one")
        return []
    table: dict[str, Any] = {"kind": asked.fault, "at_s": asked.at_s}
    if asked.until_s is not None:
        table["until_s"] = asked.until_s
    said = {one.path[1] for one in (*more, *axes) if one.path[0] == FAULT}
    kind = KINDS.get(asked.fault)
    if kind is not None and issubclass(kind, CellTarget) and not said & _TARGETS:
        table["share"] = 1.0
    return [Override((FAULT,), table, f"--fault {asked.fault}"), *more]


def _placed(override: Override, place: int) -> Override:
    """An override of the campaign's fault as one of the scene's ``faults``, the last."""
    return Override(("faults", place, *override.path[1:]), override.value, override.option)
