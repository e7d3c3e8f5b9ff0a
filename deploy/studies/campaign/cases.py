"""Cases of a campaign: a scene for every combination of values, and its baseline."""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from bus.fault import CellTarget, FaultSpec
from deploy.errors import InputError
from deploy.faults.registry import KINDS
from deploy.scenes.errors import KeyPath
from deploy.scenes.files import parse_scene
from deploy.scenes.overrides import Override
from deploy.studies.campaign.criterion import Criterion, criterion_of
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.campaign.spec import CampaignSpec


FAULT = "fault"
"""First part of a key that belongs to the fault of the campaign, not to the scene."""

_MOST_VALUES = 10_000
"""Values of one key, and seeds."""
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER})(?::({_NUMBER}))?")
_WHOLE = re.compile(r"[+-]?\d+")


@final
@dataclass(frozen=True, slots=True)
class Axis:
    """Axis of the grid: a key and its values.

    Attributes:
        key: As it was given, with dots.
        path: The same in parts.
        values: At least one, all different, as TOML would have them.
        option: What the user typed; errors name it.
    """

    key: str
    path: KeyPath
    values: tuple[Any, ...]
    option: str

    @classmethod
    def parse(cls, text: str, option: str) -> Axis:
        """Read ``KEY=VALUES``.

        Args:
            text: The key, and what `values_of` reads.
            option: What the user typed.

        Raises:
            InputError: It is no such thing.
        """
        key, equals, values = text.partition("=")
        if not equals:
            raise InputError(
                f"{option}: must be KEY=VALUES: FROM:TO:STEP, or values with commas between them"
            )
        path = Override.parse(f"{key}=0", option).path
        if path == ("seed",):
            raise InputError(f"{option}: seeds are varied by --seeds")
        return cls(key.strip(), path, values_of(values.strip(), option), option)

    def override(self, value: Any) -> Override:
        """Return the override that sets the axis' key to a value."""
        return Override(self.path, value, f"{self.option}, value {value}")


def values_of(text: str, option: str) -> tuple[Any, ...]:
    """``FROM:TO:STEP``, TO included where the steps reach it, or TOML values with commas between them.

    Steps are counted in decimal, as they were typed: the third of 0:0.5:0.1 is the number 0.2 itself. Values are whole
    numbers only where FROM and STEP are. Bare words need no quotes.

    Raises:
        InputError: Neither, no value at all, too many, or one of them twice.
    """
    found = _RANGE.fullmatch(text)
    values = _listed(text, option) if found is None else _range(found[1], found[2], found[3], option)
    if not values:
        raise InputError(f"{option}: must have a value")
    if len({repr(value) for value in values}) < len(values):
        raise InputError(f"{option}: a value is given twice")
    return values


def _range(start: str, stop: str, step: str | None, option: str) -> tuple[Any, ...]:
    first, last, stride = Decimal(start), Decimal(stop), Decimal(step or "1")
    if not stride:
        raise InputError(f"{option}: the step must not be 0")
    count = math.floor((last - first) / stride) + 1
    if count < 1:
        raise InputError(f"{option}: steps of {stride} don't lead from {first} to {last}")
    if count > _MOST_VALUES:
        raise InputError(f"{option}: {count:,} values; at most {_MOST_VALUES:,}")
    whole = bool(_WHOLE.fullmatch(start) and _WHOLE.fullmatch(step or "1"))
    numbers = (first + stride * i for i in range(count))
    return tuple(int(number) if whole else float(number) for number in numbers)


def _listed(text: str, option: str) -> tuple[Any, ...]:
    try:
        table = tomllib.loads(f"values = [{text}]")
    except tomllib.TOMLDecodeError:
        words = [Override.parse(f"value={word}", option) for word in text.split(",")]
        return tuple(word.value for word in words)
    if len(table) != 1:  # a line break in the values began another key
        raise InputError(f"{option}: must be values of one key, not of {len(table)}")
    return tuple(table["values"])


def seeds_of(text: str, first: int) -> tuple[int, ...]:
    """The seeds that ``--seeds`` asks for.

    Args:
        text: How many; or ``FROM:TO``, ``FROM:TO:STEP``, or a list.
        first: The first of so many: the scene's own.

    Raises:
        InputError: It is no such thing, or a seed is none.
    """
    option = f"--seeds {text}"
    if _WHOLE.fullmatch(text):
        if not 1 <= int(text) <= _MOST_VALUES:
            raise InputError(f"{option}: must be 1..{_MOST_VALUES:,}")
        return tuple(range(first, first + int(text)))
    seeds = values_of(text, option)
    for seed in seeds:
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**63:
            raise InputError(f"{option}: {seed}: a seed must be a whole number from 0")
    return seeds


def combinations(axes: Sequence[Axis]) -> Iterator[tuple[Any, ...]]:
    """Every combination of values, the last key's fastest; a single empty one where nothing is varied."""
    return itertools.product(*(axis.values for axis in axes))


def check_size(axes: Sequence[Axis], seeds: Sequence[int], most: int) -> None:
    """Refuse a campaign of more than ``most`` runs.

    Raises:
        InputError: It is one.
    """
    runs = math.prod(len(axis.values) for axis in axes) * len(seeds)
    if runs > most:
        raise InputError(f"campaign: {plural(runs, 'run')}; at most {most:,}")


_TARGETS = CellTarget.model_fields.keys() - FaultSpec.model_fields.keys()
"""Keys by which a fault selects its affected cells."""

_MOST_RUNS = 1_000_000
"""Runs of a campaign."""


@final
@dataclass(frozen=True, slots=True)
class Case:
    """One combination of values, for all seeds.

    Attributes:
        number: Position in the grid, the last key fastest.
        values: Varied values, by key.
        scene: Scene of the runs.
        baseline: Scene that the runs are compared with; None: no comparison.
        criterion: Success criterion of the runs.
        baseline_result: Identifier of the baseline scene without the seed, equal for cases with the same baseline;
            empty without a baseline.
    """

    number: int
    values: dict[str, Any]
    scene: Scene
    baseline: Scene | None
    criterion: Criterion
    baseline_result: str = ""

    def baseline_id(self, seed: int) -> str:
        """Return the identifier of the baseline run for a seed; empty without a baseline."""
        return f"{self.baseline_result}-{seed}" if self.baseline_result else ""


@final
@dataclass(frozen=True, slots=True)
class Cases:
    """All cases of a campaign.

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
        """Number of runs, without baselines."""
        return len(self.cases) * len(self.seeds)

    @property
    def baseline_runs(self) -> int:
        """Number of baseline runs; a baseline that several cases share counts once."""
        return len({case.baseline_result for case in self.cases} - {""}) * len(self.seeds)


def with_seed(scene: Scene, seed: int) -> Scene:
    """Return a copy of the scene with another seed; validity doesn't depend on the seed."""
    return scene.model_copy(update={"seed": seed})


def cases_of(spec: CampaignSpec, text: str) -> Cases:
    """Make and validate the scenes of all cases.

    Args:
        spec: The campaign.
        text: TOML of its scene.

    Raises:
        InputError: The options make no sense, or not with this scene; nothing was started.
    """
    everywhere, of_fault = _sets(spec)
    folder = None if spec.folder is None else Path(spec.folder)

    def scene_with(overrides: Sequence[Override]) -> Scene:
        return parse_scene(text, spec.scene, [*everywhere, *overrides], folder)

    plain = scene_with(())
    axes = _axes(spec)
    seeds = seeds_of(spec.seeds, plain.seed)
    check_size(axes, seeds, _MOST_RUNS)
    against = [Override.parse(one, f"--against {one}") for one in spec.against]
    fault = _fault(spec, of_fault, axes)
    place = len(plain.faults)

    def case(number: int, values: tuple[Any, ...]) -> Case:
        varied = [axis.override(value) for axis, value in zip(axes, values, strict=True)]
        own = [one for one in varied if one.path[0] != FAULT]
        faulty = [*fault, *(one for one in varied if one.path[0] == FAULT)]
        baseline = scene_with([*own, *against]) if fault or against else None
        scene = scene_with([*own, *(_placed(one, place) for one in faulty)])
        return Case(
            number,
            {axis.key: value for axis, value in zip(axes, values, strict=True)},
            scene,
            baseline,
            criterion_of(spec, scene, compared=baseline is not None),
            "" if baseline is None else sha256(baseline.canonical()).hexdigest()[:16],
        )

    return Cases(plain, axes, seeds, tuple(case(*one) for one in enumerate(combinations(axes))))


def _sets(spec: CampaignSpec) -> tuple[list[Override], list[Override]]:
    """Split ``--set`` options into overrides of the scene and of the campaign's fault."""
    sets = [Override.parse(text) for text in spec.set]
    if spec.duration_s is not None:
        sets.append(Override(("duration_s",), spec.duration_s, f"--duration {spec.duration_s:g}"))
    everywhere = [one for one in sets if one.path[0] != FAULT]
    of_fault = [one for one in sets if one.path[0] == FAULT]
    for one in of_fault:
        _check_fault(spec, one.path, one.option)
    return everywhere, of_fault


def _axes(spec: CampaignSpec) -> tuple[Axis, ...]:
    options = [] if spec.share is None else [(f"{FAULT}.share={spec.share}", f"--share {spec.share}")]
    options += [(one, f"--vary {one}") for one in spec.vary]
    axes = tuple(Axis.parse(text, option) for text, option in options)
    for number, axis in enumerate(axes):
        _check_fault(spec, axis.path, axis.option)
        if axis.path in [other.path for other in axes[:number]]:
            raise InputError(f"{axis.option}: {axis.key} is varied twice")
    return axes


def _check_fault(spec: CampaignSpec, path: Sequence[str | int], option: str) -> None:
    if path[0] != FAULT:
        return
    if len(path) < 2:
        raise InputError(f"{option}: must name a key of the fault: {FAULT}.KEY")
    if spec.fault is None:
        raise InputError(f"{option}: needs a fault: --fault KIND adds one")


def _fault(spec: CampaignSpec, more: Sequence[Override], axes: Sequence[Axis]) -> list[Override]:
    """The campaign's fault, without what is varied of it; empty where there is none.

    A fault of cells without a target affects all of them.
    """
    if spec.fault is None:
        for option, given_s in (("--at", spec.at_s or None), ("--until", spec.until_s)):
            if given_s is not None:
                raise InputError(f"{option} {given_s:g}: needs a fault: --fault KIND adds one")
        return []
    table: dict[str, Any] = {"kind": spec.fault, "at_s": spec.at_s}
    if spec.until_s is not None:
        table["until_s"] = spec.until_s
    said = {one.path[1] for one in (*more, *axes) if one.path[0] == FAULT}
    kind = KINDS.get(spec.fault)
    if kind is not None and issubclass(kind, CellTarget) and not said & _TARGETS:
        table["share"] = 1.0
    return [Override((FAULT,), table, f"--fault {spec.fault}"), *more]


def _placed(override: Override, place: int) -> Override:
    """An override of the campaign's fault as one of the scene's ``faults``, the last."""
    return Override(("faults", place, *override.path[1:]), override.value, override.option)
