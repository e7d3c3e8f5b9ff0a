"""Messages that kernels refuse are those that receivers on arrays refuse, whatever bytes a link brings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.wire.message_type import bounded_list, leaves
from cell_firmware.firmware import Inbox
from cell_firmware.kernels import plausibility as kernels
from cell_firmware.kernels.arguments import message_bytes
from cell_firmware.program import NoParameters, Program
from cell_firmware.refusals import plausibility_checks, refuse

MESSAGE = np.dtype(
    [
        ("single", "<f4"),
        ("double", "<f8"),
        ("any_single", "<f4"),
        ("any_double", "<f8", (2,)),
        ("flag", "?"),
        ("byte", "u1"),
        ("small", "i1", (3,)),
        ("short", "<i2"),
        ("wide", "<i8"),
        ("most", "<u8"),
        ("route", bounded_list("<i4", 3)),
        ("stops", bounded_list([("x", "<f4"), ("n", "<u2")], 2)),
    ]
)
RANGES: dict[str, tuple[float, float]] = {
    "single": (-0.1, 0.1),  # no float32
    "double": (-0.1, 0.1),
    "flag": (0, 0.5),
    "byte": (3, 250.5),
    "small": (-100, 1000),
    "short": (-300, 7),
    "wide": (-5.0, 1e18),
    "most": (1, 2**52),
    "route.items": (-2, 2),
    "stops.items.1.n": (0, 3),
}
EDGES = (0.0, 0.1, -0.1, 1e18, np.nan, np.inf, -np.inf, 1e-40, 5e-324, 3.4028234663852886e38)


class Speaker(Program):
    """A program whose messages have numbers of every type."""

    message = MESSAGE

    def __init__(self, ranges: Mapping[str, tuple[float, float]]) -> None:
        super().__init__(NoParameters())
        self.ranges = ranges

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        return self.ranges


def drawn(n: int) -> NDArray[Any]:
    """Messages of likely and of unlikely numbers, a few of the latter in each."""
    draw = np.random.default_rng(5)
    messages = np.zeros((n, 4), dtype=MESSAGE)
    messages["byte"], messages["most"] = 100, 2
    for leaf in leaves(MESSAGE):
        numbers = leaf.of(messages)
        hit = draw.random(numbers.shape) < 0.06
        data = draw.integers(0, 256, (int(hit.sum()), leaf.type.itemsize), dtype=np.uint8)
        if leaf.type.kind == "b":
            data %= 2
        instead = data.view(leaf.type)[:, 0]
        if leaf.type.kind == "f":
            edges = draw.choice(np.array(EDGES), len(instead))
            with np.errstate(over="ignore"):
                instead = np.where(draw.random(len(instead)) < 0.7, edges, instead).astype(leaf.type)
        elif leaf.type.kind in "iu":
            near = draw.integers(-4, 9, len(instead)) + draw.choice(np.array([0, 0, 250, -300]), len(instead))
            instead = np.where(draw.random(len(instead)) < 0.7, near.astype(leaf.type), instead)
        numbers[hit] = instead
    return messages


@pytest.mark.parametrize("ranges", [RANGES, {}, {"double": (-np.inf, 1)}])
def test_a_kernel_accepts_the_messages_that_a_program_accepts(ranges: dict[str, tuple[float, float]]) -> None:
    program, messages = Speaker(ranges), drawn(2_000)
    everything = np.ones(messages.shape, dtype=np.bool_)
    kept, refused = refuse(program, Inbox(everything, messages))
    checks = plausibility_checks(program)
    assert checks is not None
    data = message_bytes(messages)
    numbers = [
        kernels.refuse(
            checks.ctypes.data, len(checks), received.ctypes.data, data[i].ctypes.data, MESSAGE.itemsize
        )
        for i, received in enumerate(everything)
    ]
    assert everything.tolist() == kept.received.tolist()
    assert messages.tobytes() == kept.message.tobytes()
    assert numbers == refused.tolist()
    assert refused.tolist() == (~kept.received).sum(axis=1).tolist()
    assert 0.1 < kept.received.mean() < 0.95


@pytest.mark.parametrize(
    "program",
    [
        Speaker({"wide": (0, 2**53)}),
        Speaker({"double": (np.float64(0.0), np.float64(1.0))}),
        type("Own", (Speaker,), {"accepts": lambda self, messages: messages["flag"]})({}),
        type("Halves", (Speaker,), {"message": np.dtype([("half", "<f2")])})({}),
    ],
    ids=["bounds beyond float64", "numbers with types of their own", "a check of its own", "half precision"],
)
def test_what_kernels_cannot_check_as_a_program_does_is_left_to_arrays(program: Program) -> None:
    assert plausibility_checks(program) is None
