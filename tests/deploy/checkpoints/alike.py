"""Two graphs of objects, compared attribute by attribute: what differs was not remembered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

OURS = ("bus.", "cell_firmware.", "deploy.", "plant.", "tests.")
SCRATCH = {
    ("ThreadedSolver", "_workspaces"): "what threads work with: written before it is read",
    ("CounterStream", "_counter"): "set before every draw",
    ("CounterStream", "_state"): "likewise",
    ("PlantProcess", "_coordinator"): "the cells are looked at by themselves",
    ("PlantProcess", "hooks"): "they belong to whoever runs it",
    ("CompiledController", "_bound"): "the memory of the shard's state, where that was stepped before",
    ("Shard", "_kernel"): "likewise: it takes over a state before it steps it",
    ("Shard", "_undisturbed"): "likewise",
    ("Shard", "_controller"): "chosen anew before the next tick",
    ("Shard", "_form_end_tick"): "likewise",
    ("NeighbourList", "_there"): "where parcels were when it was made; one made anew has the same pairs",
    ("NeighbourList", "_centre"): "likewise",
    ("NeighbourList", "_pairs"): "likewise",
    ("AllTransfer", "change"): "corrections of a pass, written before they are read",
    ("Spots", "_parcels"): "states are put in before they are looked at",
}
"""Attributes that may differ, and why."""


def differences(one: Any, other: Any) -> list[str]:
    """Paths to what is not the same in two objects that should be alike."""
    return list(_compared(one, other, type(one).__name__, set()))


def _compared(one: Any, other: Any, path: str, seen: set[tuple[int, int]]) -> Iterator[str]:
    if (id(one), id(other)) in seen or one is other:
        return
    seen.add((id(one), id(other)))
    if type(one) is not type(other):
        yield f"{path}: {type(one).__name__} and {type(other).__name__}"
    elif isinstance(one, np.ndarray):
        if one.dtype.hasobject:
            yield from _compared(one.tolist(), other.tolist(), path, seen)
        elif one.shape != other.shape or one.tobytes() != other.tobytes():
            yield path
    elif isinstance(one, np.random.Generator):
        yield from _compared(one.bit_generator.state, other.bit_generator.state, path, seen)
    elif isinstance(one, bool | int | float | str | bytes | set | frozenset | np.generic):
        if one != other:
            yield path
    elif (parts := _parts(one)) is not None:
        yield from _items(parts, _parts(other) or {}, path, seen)
    if type(one).__module__.startswith(OURS):
        yield from _items(attributes(one), attributes(other), path, seen)


def _items(
    one: Mapping[Any, Any], other: Mapping[Any, Any], path: str, seen: set[tuple[int, int]]
) -> Iterator[str]:
    if one.keys() != other.keys():
        yield path
        return
    for key in one:
        yield from _compared(one[key], other[key], f"{path}.{key}", seen)


def _parts(values: Any) -> Mapping[Any, Any] | None:
    """Items of a mapping or a sequence, fields of a named tuple without scratch; None of anything else."""
    if isinstance(values, Mapping):
        return values
    if hasattr(values, "_asdict"):
        kind = type(values).__name__
        return {name: value for name, value in values._asdict().items() if (kind, name) not in SCRATCH}
    if hasattr(values, "__len__") and hasattr(values, "__getitem__") and hasattr(values, "__iter__"):
        return dict(enumerate(values))
    return None


def attributes(owner: Any) -> dict[str, Any]:
    """What an object keeps in attributes, scratch left out."""
    slots = [name for base in type(owner).__mro__ for name in vars(base).get("__slots__", ())]
    found = {name: getattr(owner, name) for name in slots if hasattr(owner, name)}
    found |= getattr(owner, "__dict__", {})
    scratch = {name for base in type(owner).__mro__ for kind, name in SCRATCH if kind == base.__name__}
    return {name: value for name, value in found.items() if name not in scratch}
