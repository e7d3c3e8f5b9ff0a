"""What objects remember, as bytes and back."""

from __future__ import annotations

from array import array
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, ClassVar, NamedTuple, cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.errors import StateError
from bus.state import StateFields, load_state, save_state
from bus.state_codec import decode, encode, is_record

packed: Callable[[object], bytes] = cast("Any", msgpack).packb


class Pair(NamedTuple):
    left: int
    right: str


@dataclass(frozen=True)
class Reading:
    level: Any


class Wheel:
    state_fields: ClassVar[StateFields] = StateFields("turns")

    def __init__(self) -> None:
        self.turns = 0
        self.radius = 3


class Motor(Wheel):
    state_fields: ClassVar[StateFields] = StateFields("volts", "last", records=(Pair,))

    def __init__(self) -> None:
        super().__init__()
        self.volts: Any = np.zeros(2)
        self.last: Pair | None = None


class Packed(NamedTuple):
    y: Any
    fixed: Any


class Car:
    state_fields: ClassVar[StateFields] = StateFields("motors", "luck", shared=("log", "packed.y"))

    def __init__(self) -> None:
        self.motors = [Motor(), Motor()]
        self.luck = np.random.default_rng(7)
        self.log: list[str] = []
        self.packed = Packed(np.zeros(3), np.ones(3))
        self.view = self.packed.y[:2]
        self.readers = self.log


RECORDS = {"Pair": Pair, "Reading": Reading}

VALUES: list[Any] = [
    None,
    True,
    -3,
    2**100,
    0.1,
    float("inf"),
    "text",
    b"bytes",
    (1, (2, 3)),
    [1, [2]],
    {"a": 1},
    {1: "b", (2, 3): "c"},
    {(1, 2), (3, 4)},
    deque([(1, "x")]),
    Counter({"lost": 0, "late": 2}),
    Fraction(1, 3),
    Pair(1, "r"),
    Reading((1, None)),
    array("q", [1, 2]),
    array("d", [0.5]),
    np.float64(0.1),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_a_value_comes_back_as_it_was(value: Any) -> None:
    back = decode(encode(value, RECORDS), RECORDS)
    assert type(back) is type(value)
    assert back == value


@pytest.mark.parametrize(
    "array_",
    [
        np.arange(6.0).reshape(2, 3)[:, ::2],
        np.zeros((0, 4)),
        np.array([True, False]),
        np.array([(1, True)], dtype=[("x", "<i2"), ("sent", "?")]),
        np.array([-0.0, np.nan]),
        np.arange(2.0).view("V8"),
    ],
    ids=repr,
)
def test_an_array_comes_back_bit_for_bit_and_may_be_written(array_: Any) -> None:
    back = decode(encode(array_, {}), {})
    assert (back.dtype, back.shape, back.tobytes()) == (array_.dtype, array_.shape, array_.tobytes())
    back[...] = array_


def test_an_array_of_objects_holds_values() -> None:
    states = np.empty(2, dtype=object)
    states[0], states[1] = {"n": 1}, (2, [3])
    assert decode(encode(states, {}), {}).tolist() == states.tolist()


@pytest.mark.parametrize(
    "value",
    [object(), lambda: 0, Pair(1, "r"), np.array(["text"]), {1, "a"}],
    ids=["an object", "a function", "a record", "an array of texts", "a set of several types"],
)
def test_an_unsupported_value_is_refused_when_it_is_saved(value: Any) -> None:
    with pytest.raises((StateError, TypeError)):
        encode(value, {})


def _driven() -> Car:
    car = Car()
    car.motors[1].turns, car.motors[1].volts, car.motors[0].last = 5, np.array([1.0, 2.0]), Pair(1, "r")
    car.luck.normal(size=3)
    car.log.append("start")
    car.packed.y[:] = 1.5
    return car


def test_a_reinitialised_object_loads_the_state_of_another() -> None:
    car, other = _driven(), Car()
    load_state(other, save_state(car))
    assert save_state(other) == save_state(car)
    assert (other.motors[1].turns, other.motors[0].last) == (5, Pair(1, "r"))
    assert other.luck.normal() == car.luck.normal()


def test_what_others_hold_too_is_changed_where_it_is() -> None:
    other = Car()
    load_state(other, save_state(_driven()))
    assert other.view.tolist() == [1.5, 1.5]
    assert other.readers == ["start"]


def _changed(change: str) -> bytes:
    car = _driven()
    match change:
        case "an object too few":
            car.motors.pop()
        case "another kind":
            car.motors[0].turns = "many"  # type: ignore[assignment]
        case "another type of array":
            car.motors[0].volts = np.zeros(2, dtype=np.int32)
        case "another shape":
            car.packed = Packed(np.zeros(4), np.ones(3))
        case "another name":
            return save_state(car).replace(b"volts", b"watts")
        case _:
            raise AssertionError(change)
    return save_state(car)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("an object too few", r"Car\.motors: must be"),
        ("another kind", r"Car\.motors\[0\]\.turns: must be a int, is a str"),
        ("another type of array", r"Car\.motors\[0\]\.volts: must be 1 dimensions of float64"),
        ("another shape", r"Car\.packed\.y: must be float64 \(3,\), is float64 \(4,\)"),
        ("another name", r"Car\.motors\[0\]: must be last, turns, volts, is last, turns, watts"),
    ],
)
def test_a_memory_of_something_else_is_refused_by_place(change: str, problem: str) -> None:
    with pytest.raises(StateError, match=problem):
        load_state(Car(), _changed(change))


class Holder:
    state_fields: ClassVar[StateFields] = StateFields("held")

    def __init__(self, held: Any) -> None:
        self.held = held


class Shares:
    state_fields: ClassVar[StateFields] = StateFields(shared=("held",))

    def __init__(self, held: Any) -> None:
        self.held = held


class Leads:
    state_fields: ClassVar[StateFields] = StateFields("way.turns")

    def __init__(self, way: Any) -> None:
        self.way = way


def _turned(turns: int) -> Wheel:
    wheel = Wheel()
    wheel.turns = turns
    return wheel


def test_objects_in_maps_and_lists_remember_each_at_its_place() -> None:
    held = {"a": _turned(3), "b": [_turned(4), _turned(5)], "c": ()}
    fresh = {"a": Wheel(), "b": [Wheel(), Wheel()], "c": ()}
    stay = fresh["a"]
    load_state(Holder(fresh), save_state(Holder(held)))
    assert fresh["a"] is stay
    assert [fresh["a"].turns, *(wheel.turns for wheel in fresh["b"])] == [3, 4, 5]


@pytest.mark.parametrize(
    ("held", "fresh"), [(None, 3), (3, None), (0.5, 0), (np.float64(2.0), False), ({1: 2}, {})], ids=repr
)
def test_a_value_may_come_to_be_nothing_or_another_kind_of_number(held: Any, fresh: Any) -> None:
    holder = Holder(fresh)
    load_state(holder, save_state(Holder(held)))
    assert (type(holder.held), holder.held) == (type(held), held)


@pytest.mark.parametrize(
    ("held", "fresh", "problem"),
    [
        (Wheel(), 3, "must be a int, which declares no state"),
        ({"a": Wheel()}, {"b": Wheel()}, "must be 1 objects"),
        ((Wheel(),), [Wheel()], "must be other objects"),
        ([[], Wheel()], [[Wheel()], Wheel()], r"held\[0\]: must be an object"),
        ({"a": Wheel(), "b": 4}, {"a": Wheel(), "b": 3}, r"held\[b\]: must be an object"),
        (3, "text", "must be a str, is a int"),
        ([1], {}, "must be a dict, is a list"),
        ({}, [1], "must be a list, is a dict"),
        (np.zeros(2), np.zeros((2, 1)), "must be 2 dimensions of float64, is 1"),
        (np.random.default_rng(1), 3, "must be a int, is a random generator's state"),
    ],
)
def test_state_that_does_not_fit_a_reinitialised_object_is_refused(
    held: Any, fresh: Any, problem: str
) -> None:
    with pytest.raises(StateError, match=problem):
        load_state(Holder(fresh), save_state(Holder(held)))


@pytest.mark.parametrize(
    ("held", "fresh"), [({"a": 1}, {"b": 2}), ({1, 2}, {3}), ([1], [2, 3]), (None, None)], ids=repr
)
def test_shared_maps_sets_and_lists_are_refilled_in_place(held: Any, fresh: Any) -> None:
    shares = Shares(fresh)
    load_state(shares, save_state(Shares(held)))
    assert shares.held is fresh
    assert fresh == held


def test_what_is_shared_keeps_its_kind() -> None:
    with pytest.raises(StateError, match="must be a set, is a list"):
        load_state(Shares(set[int]()), save_state(Shares([1])))
    with pytest.raises(StateError, match="this is a bug: a int can't be shared"):
        load_state(Shares(1), save_state(Shares(2)))


def test_a_path_that_breaks_off_leads_to_nothing_and_stays_so() -> None:
    leads = Leads(None)
    load_state(leads, save_state(leads))
    assert leads.way is None
    with pytest.raises(StateError, match=r"Leads\.way\.turns: must be None, is a int"):
        load_state(leads, save_state(Leads(_turned(2))))


@given(st.binary(max_size=64))
def test_any_bytes_are_a_value_that_can_be_saved_or_are_refused(data: bytes) -> None:
    try:
        value = decode(data, RECORDS)
    except StateError:
        return
    saved = encode(value, RECORDS)
    assert encode(decode(saved, RECORDS), RECORDS) == saved


@settings(max_examples=60)
@given(st.data())
def test_changed_bytes_are_a_state_that_can_be_saved_or_are_refused(data: st.DataObject) -> None:
    whole = bytearray(save_state(_driven()))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    car, other = Car(), Car()
    try:
        load_state(car, bytes(whole))
    except StateError:
        return
    saved = save_state(car)
    load_state(other, saved)
    assert save_state(other) == saved


def test_an_array_that_says_it_is_larger_than_its_bytes_is_refused() -> None:
    encoded = packed(["<f8", [2**40, 2**40], b""])
    with pytest.raises(StateError, match="0 bytes for an array"):
        decode(packed(msgpack.ExtType(1, encoded)), {})


def test_nesting_without_end_is_refused() -> None:
    data = packed([])
    for _ in range(3_000):
        data = packed(msgpack.ExtType(4, data))
    with pytest.raises(StateError, match="not a saved state"):
        decode(data, {})


def test_values_lie_as_deep_as_they_may_and_as_many_side_by_side_as_they_like() -> None:
    deep: Any = ()
    for _ in range(30):
        deep = (deep,)
    for value in (deep, [(i,) for i in range(100)]):
        assert decode(encode(value, {}), {}) == value
    with pytest.raises(StateError, match="too deep"):
        encode((deep,), {})


@pytest.mark.parametrize(
    "encoded",
    [
        ["<f8", [-1], b""],
        ["<f8", [-1, -1], b"8 bytes!"],
        ["<f8", [True], b"8 bytes!"],
        ["<f8", [1] * 9, b"8 bytes!"],
        ["i4,i4", [1], b"8 bytes!"],
        ["<f16", [1], b"16 bytes, 16 ..."],
        ["?", [1], b"\x02"],
    ],
    ids=repr,
)
def test_an_array_that_no_array_is_written_as_is_refused(encoded: list[Any]) -> None:
    with pytest.raises(StateError, match="not a saved state: ValueError"):
        decode(packed(msgpack.ExtType(1, packed(encoded))), {})


def test_an_array_has_as_many_objects_as_places() -> None:
    with pytest.raises(StateError, match="1 objects for an array of 2"):
        decode(packed(msgpack.ExtType(3, packed([[2], [None]]))), {})


@pytest.mark.parametrize(("fields", "read"), [(256, True), (257, False)])
def test_an_array_has_so_many_fields_and_no_more(fields: int, read: bool) -> None:
    encoded = [[[f"f{i}", "<u1", []] for i in range(fields)], [1], bytes(fields)]
    data = packed(msgpack.ExtType(1, packed(encoded)))
    if read:
        assert len(decode(data, {}).dtype) == fields
        return
    with pytest.raises(StateError, match="an array of 257 fields"):
        decode(data, {})


@dataclass(frozen=True)
class Derived:
    level: int
    twice: int = field(init=False)


class Named(tuple[int, ...]):
    pass


class Fields:
    _fields = ("a",)


@pytest.mark.parametrize("kind", [Derived, Named, Fields, Wheel, Pair(1, "r"), Reading(1), int])
def test_a_record_is_a_class_of_values_that_are_made_of_their_parts(kind: Any) -> None:
    assert is_record(Pair)
    assert is_record(Reading)
    assert not is_record(kind)
