"""State of objects between ticks: declared by classes, saved, and loaded into objects built the same way.

A class whose objects change during a run names the attributes that change::

    class Motors:
        state_fields: ClassVar[StateFields] = StateFields("_volts", "_speed", "_travel")

``save_state`` encodes these attributes, and the state of all objects reachable from them. ``load_state`` restores the
state in an object built from the same scene, whose constant attributes are in place already. The fields of a class
are added to those of its bases.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, cast, final

import numpy as np

from bus.errors import StateError
from bus.state_codec import DECODE_ERRORS, ObjectState, Records, RngState, decode, encode

DECLARED: Final = "state_fields"
"""Name of the class attribute that holds the ``StateFields``."""


@final
class StateFields:
    """State attributes that a class declares.

    Values are numbers, texts, arrays, and containers of these; random generators; and objects that declare their own
    state fields.

    Args:
        names: Attributes that are replaced on loading. A path (``packed.y``) leads through objects that are retained.
        shared: Attributes whose values are updated in place, as other objects share them: arrays of one shape, lists,
            maps, sets.
        records: Frozen dataclasses and named tuples among the values.
    """

    __slots__ = ("names", "records", "shared")

    def __init__(self, *names: str, shared: Sequence[str] = (), records: Sequence[type] = ()) -> None:
        self.names = names
        self.shared = tuple(shared)
        self.records = tuple(records)


def save_state(owner: Any, records: Sequence[type] = ()) -> bytes:
    """Save the state of an object as bytes.

    Args:
        owner: The object.
        records: More types of values than its classes declare.

    Raises:
        StateError: The state holds an object that can't be encoded; names the type.
    """
    return encode(_part(owner), _records(owner, records))


def load_state(owner: Any, data: bytes, records: Sequence[type] = ()) -> None:
    """Load saved state into an object built in the same way as the saved one.

    Args:
        owner: Object to load into, built as the saved one was. Unusable if this raises.
        data: Result of ``save_state``.
        records: As for ``save_state``.

    Raises:
        StateError: The data is no state of such an object; names the attribute.
    """
    part = decode(data, _records(owner, records))
    if not _is(part, ObjectState):
        raise StateError(f"not the state of a {type(owner).__name__}")
    try:
        _put_back(owner, part, type(owner).__name__)
    except DECODE_ERRORS as error:
        raise StateError(
            f"not the state of a {type(owner).__name__}: {type(error).__name__}: {error}"
        ) from None


def declared(kind: Any) -> list[StateFields]:
    """Return the state fields that a class and its bases declare, the bases first."""
    return [vars(base)[DECLARED] for base in reversed(kind.__mro__) if DECLARED in vars(base)]


# --- taking out -------------------------------------------------------------------------------------


def _part(owner: Any) -> ObjectState:
    return ObjectState({name: _taken(value) for name, value in _values(owner)})


def _values(owner: Any) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of every state field of an object."""
    for state_fields in declared(type(owner)):
        for name in (*state_fields.names, *state_fields.shared):
            yield name, _found(owner, name)


def _found(owner: Any, path: str) -> Any:
    """The value at the end of a path; None where it breaks off."""
    for name in path.split("."):
        if owner is None:
            return None
        owner = getattr(owner, name)
    return owner


def _taken(value: Any) -> Any:
    """Replace the stateful objects inside a value by their saved states."""
    kind = cast("Any", type(value))
    if _is(value, np.random.Generator):
        return RngState(value.bit_generator.state)
    if declared(kind):
        return _part(value)
    if _is(value, list, tuple, deque):
        return kind(map(_taken, value))
    if _is_map(value):
        made: Any = kind if hasattr(kind, "update") else dict  # a view of a map can't be made of one
        return made({key: _taken(item) for key, item in value.items()})
    return value


def _is_map(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is(value: Any, *kinds: Any) -> bool:
    """Whether a value is of one of these types itself, of none derived from it."""
    return type(value) in kinds


def _records(owner: Any, more: Sequence[type]) -> Records:
    """Return the record types, by name, declared by an object and all objects reachable from it."""
    found = {kind.__qualname__: kind for kind in more}
    for part in _objects(owner):
        for state_fields in declared(type(part)):
            found |= {kind.__qualname__: kind for kind in state_fields.records}
    return found


def _objects(value: Any) -> Iterator[Any]:
    """Yield the stateful objects inside a value, and all objects reachable from these."""
    if declared(type(value)):
        yield value
        for _, item in _values(value):
            yield from _objects(item)
    elif _is_map(value) or _is(value, list, tuple):
        for item in value.values() if _is_map(value) else value:
            yield from _objects(item)


# --- putting back -----------------------------------------------------------------------------------


def _put_back(owner: Any, part: ObjectState, place: str) -> None:
    names = [name for name, _ in _values(owner)]
    if part.values.keys() != set(names):
        raise StateError(f"{place}: must be {', '.join(sorted(names))}, is {', '.join(sorted(part.values))}")
    for state_fields in declared(type(owner)):
        for name in (*state_fields.names, *state_fields.shared):
            where, value = f"{place}.{name}", part.values[name]
            # Looked up only now: what a name means may hang on those before it.
            now = _found(owner, name)
            if name in state_fields.shared:
                _fill(now, value, where)
                continue
            merged = _merged(now, value, where)
            if merged is not now:
                _set(owner, name, merged, where)


def _set(owner: Any, path: str, value: Any, place: str) -> None:
    *parents, name = path.split(".")
    holder = _found(owner, ".".join(parents)) if parents else owner
    if holder is None:
        raise StateError(f"{place}: must be None, is a {type(value).__name__}")
    setattr(holder, name, value)


def _merged(now: Any, value: Any, place: str) -> Any:
    """Merge a saved value into the value ``now`` of a freshly built object, and return the result."""
    if _is(value, ObjectState):
        if not declared(type(now)):
            raise StateError(f"{place}: must be a {type(now).__name__}, which declares no state")
        _put_back(now, value, place)
        return now
    if _is(value, RngState):
        _set_stream(now, value, place)
        return now
    if _holds_parts(value):
        return _each(now, value, place)
    _check(now, value, place)
    return value


def _holds_parts(value: Any) -> bool:
    if _is(value, list, tuple):
        return any(map(_holds_parts, value))
    return any(map(_holds_parts, value.values())) if _is(value, dict) else _is(value, ObjectState)


def _each(now: Any, value: Any, place: str) -> Any:
    """Load the saved states in a list or map into the existing objects."""
    same = _is(value, cast("Any", type(now))) and len(now) == len(value)
    if not same or (_is(value, dict) and now.keys() != value.keys()):
        raise StateError(f"{place}: must be {len(now) if same else 'other'} objects")
    pairs = [(key, now[key], value[key]) for key in (value if _is(value, dict) else range(len(value)))]
    for key, mine, theirs in pairs:
        if _is(theirs, list, tuple) and not len(theirs) and not len(mine):
            continue
        if _merged(mine, theirs, f"{place}[{key}]") is not mine:
            raise StateError(f"{place}[{key}]: must be an object with declared state")
    return now


def _check(now: Any, value: Any, place: str) -> None:
    """Refuse a value whose type differs from that before the first tick."""
    if now is None or value is None or (_is_number(now) and _is_number(value)):
        return
    kind = cast("Any", type(now))
    if not _is(value, kind) and not (_is_map(now) and _is(value, dict)):
        raise StateError(f"{place}: must be a {kind.__name__}, is a {type(value).__name__}")
    if _is(now, np.ndarray) and (now.dtype != value.dtype or now.ndim != value.ndim):
        raise StateError(
            f"{place}: must be {now.ndim} dimensions of {now.dtype}, is {value.ndim} of {value.dtype}"
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, bool | int | float | np.generic)


def _set_stream(now: Any, value: RngState, place: str) -> None:
    if not isinstance(now, np.random.Generator):
        raise StateError(f"{place}: must be a {type(now).__name__}, is a random generator's state")
    now.bit_generator.state = value.state


def _fill(now: Any, value: Any, place: str) -> None:
    """Update a shared value in place."""
    if not _is(value, cast("Any", type(now))):
        raise StateError(f"{place}: must be a {type(now).__name__}, is a {type(value).__name__}")
    if now is None:
        return
    if _is(now, np.ndarray):
        if now.shape != value.shape or now.dtype != value.dtype:
            raise StateError(f"{place}: must be {now.dtype} {now.shape}, is {value.dtype} {value.shape}")
        now[...] = value
    elif _is(now, list):
        now[:] = value
    elif _is(now, dict, set):
        now.clear()
        now.update(value)
    else:
        raise StateError(f"{place}: this is a bug: a {type(now).__name__} can't be shared")
