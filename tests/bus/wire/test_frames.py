"""Records and message types, which all wire formats have in common."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.errors import WireError
from bus.wire.frames import (
    Control,
    Report,
    decode_control,
    decode_report,
    encode_control,
    encode_report,
)
from bus.wire.message_type import check_message
from tests.bus.wire.codecs import refusal


def test_records_survive_the_wire() -> None:
    control = Control("lost", 12, ((0, 1), (3, 4)), "disconnected")
    assert decode_control(encode_control(control), 2) == control
    counters = tuple((f"{i:064}", i) for i in range(64))
    report = Report("failed", 12, ((0, 1),), "ZeroDivisionError", (5, 6, 7, 8), counters)
    assert decode_report(encode_report(report), 1) == report


@pytest.mark.parametrize(
    "counters",
    [
        tuple((f"{i}", i) for i in range(65)),
        (("x" * 65, 1),),
        (("lost", -1),),
        (("lost", True),),
        (("lost",),),
        ((1, 1),),
    ],
)
def test_counters_that_are_none_are_refused(counters: Any) -> None:
    report = Report("counters", 12, (), "", (5, 6, 7, 8), counters)
    assert refusal(lambda p: decode_report(p, 1), encode_report(report)) == "report: type"


def test_a_record_names_no_more_cells_than_there_are() -> None:
    payload = encode_control(Control("lost", 0, ((0, 0), (0, 1))))
    assert refusal(lambda p: decode_control(p, 1), payload) == "control: type"


@pytest.mark.parametrize(
    "dtype",
    [
        np.dtype("<f8"),
        np.dtype([("tick", "<f8")]),
        np.dtype([("v", "<f8")]),
        np.dtype([("u", "<f8", (0,))]),
        np.dtype([("u", "<f8", (513,))]),
        np.dtype([("u", "O")]),
        np.dtype([("u", "O", (2,))]),
        np.dtype([("u", "S4")]),
        np.dtype([("u", "<c16")]),
        np.dtype([("u", "<M8[s]")]),
        np.dtype([("u", [("x", "S4")])]),
        np.dtype([("u", [("a b", "<f8")])]),
        np.dtype([("u", [("x", "<f8"), ("y", "<f8")], (33,))]),
        np.dtype([(f"u{i}", "<f8") for i in range(65)]),
    ],
)
def test_a_message_type_that_can_t_go_over_the_wire_is_refused(dtype: np.dtype[Any]) -> None:
    with pytest.raises(WireError, match="message payload: type"):
        check_message(dtype)


def test_a_message_type_is_made_packed_and_little_endian() -> None:
    loose = np.dtype([("n", ">i2"), ("u", "=f8")], align=True)
    packed = check_message(loose)
    assert packed.itemsize == 10
    assert packed == np.dtype([("n", "<i2"), ("u", "<f8")])
    nested = np.dtype([("pose", np.dtype([("n", ">i2", (3,)), ("x", "<f8")], align=True), (2,))], align=True)
    assert check_message(nested) == np.dtype([("pose", [("n", "<i2", (3,)), ("x", "<f8")], (2,))])
