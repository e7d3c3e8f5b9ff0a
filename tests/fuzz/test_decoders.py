"""No bytes make more of a decoder than a value that its key promises, or a WireError."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.errors import WireError
from tests.fuzz.conftest import Rounds
from tests.fuzz.mutator import Mutator
from tests.fuzz.targets import Target, targets

TARGETS = targets()
every_decoder = pytest.mark.parametrize("target", TARGETS, ids=[target.name for target in TARGETS])

PLAIN = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=20)
    | st.binary(max_size=40)
    | st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=9))
)
VALUES = st.recursive(
    PLAIN, lambda v: st.lists(v, max_size=4) | st.dictionaries(st.text(max_size=4), v), max_leaves=4
)


def accepted(target: Target, payload: bytes) -> bool:
    """Whether the decoder takes it; fails where it takes what it should not, or raises anything else."""
    try:
        _, value = target.decode(payload)
    except WireError:
        return False
    target.check(value)
    return True


@every_decoder
def test_the_frames_that_are_spoilt_are_valid_before(target: Target) -> None:
    assert all(accepted(target, frame) for frame in target.frames)


@every_decoder
@settings(max_examples=40, deadline=None, database=None)
@given(data=st.data())
def test_anything_in_the_place_of_a_field_is_read_or_refused(target: Target, data: st.DataObject) -> None:
    fields: dict[str, Any] = target.form.unpack(data.draw(st.sampled_from(target.frames)))
    for name in data.draw(st.sets(st.sampled_from(sorted(fields)), min_size=1, max_size=2)):
        fields[name] = data.draw(VALUES)
    accepted(target, target.form.pack(fields))


@every_decoder
@settings(max_examples=20, deadline=None, database=None)
@given(data=st.binary(max_size=200))
def test_any_bytes_at_all_are_read_or_refused(target: Target, data: bytes) -> None:
    accepted(target, data)


@every_decoder
def test_a_thousand_spoilt_frames_are_read_or_refused(target: Target, rounds: Rounds) -> None:
    mutator = Mutator(target.frames, f"tests {target.name}", target.form)
    taken = [accepted(target, mutator.next()) for _ in rounds(1000)]
    # some come through as other valid frames: the spoiling reaches what is behind the checks
    assert 0 < sum(taken) < len(taken) / 2


def test_the_same_seed_spoils_alike() -> None:
    frames = TARGETS[0].frames
    one, other, third = Mutator(frames, "a 1"), Mutator(frames, "a 1"), Mutator(frames, "a 2")
    assert [one.next() for _ in range(50)] == [other.next() for _ in range(50)]
    assert [one.next() for _ in range(50)] != [third.next() for _ in range(50)]
