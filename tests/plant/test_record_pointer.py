"""Records passed on by address: the same values, one argument instead of many, and one place for one record."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core.registry import cpu_target

from bus.kernel_cache.callee import kernel
from plant.kernels.common.record_pointer import RecordPointer, pointer_to

ENTRY = numba.njit(error_model="numpy", _nrt=False)


class Inner(NamedTuple):
    table: Any
    factor: float


class Outer(NamedTuple):
    values: Any
    absent: None
    inner: Inner
    flag: bool


def _outer(scale: float = 1.0) -> Outer:
    table = np.arange(6, dtype=np.int64).reshape(2, 3)
    return Outer(scale * np.arange(4.0), None, Inner(table, 0.5 * scale), flag=True)


@kernel
def weigh(inner):
    inner.table[0, 0] += 1
    return inner.factor * inner.table[1, 2]


@kernel
def total(outer):
    return weigh(outer.inner) + outer.values[3] + outer.flag + (outer.absent is None)


@ENTRY
def by_address(outer):
    outer = pointer_to(outer)
    return total(pointer_to(outer))


@ENTRY
def by_parts(outer):
    return total(outer)


def test_fields_nested_records_and_absent_parts_are_as_in_the_tuple() -> None:
    one, other = _outer(), _outer()
    assert by_address(one) == by_parts(other) == 0.5 * 5 + 3.0 + 2
    assert one.inner.table[0, 0] == other.inner.table[0, 0] == 1


def test_one_after_another_each_is_read_as_it_is() -> None:
    @ENTRY
    def both(first, second):
        result = 0.0
        for n in range(4):
            result = 10.0 * result + total(pointer_to(first if n % 2 == 0 else second))
        return result

    a, b = _outer(), _outer(2.0)
    values = by_parts(_outer()), by_parts(_outer(2.0))
    assert both(a, b) == ((values[0] * 10 + values[1]) * 10 + values[0]) * 10 + values[1]


def test_uncompiled_it_is_the_record() -> None:
    outer = _outer()
    assert pointer_to(outer) is outer


def test_a_kernel_takes_one_argument_for_it() -> None:
    by_address(_outer())
    pointed = [types for (types,) in total.signatures if isinstance(types, RecordPointer)]
    assert pointed
    models = cpu_target.target_context.data_model_manager
    assert not isinstance(models[pointed[0]].get_argument_type(), tuple)


def test_records_of_other_types_have_other_names() -> None:
    flat, deep = np.zeros(1), np.zeros((1, 1))
    first = RecordPointer(numba.typeof(Inner(flat, 1.0)))
    assert first == RecordPointer(numba.typeof(Inner(flat, 1.0)))
    assert first != RecordPointer(numba.typeof(Inner(deep, 1.0)))


def test_a_field_that_is_not_there_is_an_error() -> None:
    @ENTRY
    def wrong(outer):
        return pointer_to(outer).missing

    with pytest.raises(numba.TypingError, match="missing"):
        wrong(_outer())
