"""What is varied: keys, the values of each, and all their combinations; the seeds."""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, final

from deploy.errors import InputError
from deploy.overrides import Override
from deploy.scene_errors import Path
from deploy.words import counted

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
    """A key and the values that it takes in turn.

    Attributes:
        key: As it was given, with dots.
        path: The same in parts.
        values: At least one, all different, as TOML would have them.
        option: What the user typed; errors name it.
    """

    key: str
    path: Path
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
        """What puts a value where the key says."""
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
        raise InputError(f"{option}: no value at all")
    if len({repr(value) for value in values}) < len(values):
        raise InputError(f"{option}: the same value twice")
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
        raise InputError(f"{option}: values of one key, not of {len(table)}")
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
            raise InputError(f"{option}: so many must be 1..{_MOST_VALUES:,}")
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
        raise InputError(f"campaign: {counted(runs, 'run')}; at most {most:,}")
