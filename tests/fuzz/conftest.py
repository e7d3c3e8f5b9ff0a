"""How long the fuzzers go on: a number of rounds, or with ``--nightly`` ten minutes for all of them together."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

NIGHTLY_S = 600.0
Rounds = Callable[[int], Iterator[int]]


def counted(at_least: int, seconds: float, clock: Callable[[], float]) -> Iterator[int]:
    """Count from 0, to a number of rounds at least, and on until so many seconds have passed."""
    begun, number = clock(), 0
    while number < at_least or clock() - begun < seconds:
        yield number
        number += 1


@pytest.fixture
def rounds(request: pytest.FixtureRequest) -> Rounds:
    """Counts rounds of fuzzing; at night each fuzzer has an equal share of the time."""
    share_s = 0.0
    if request.config.getoption("nightly"):
        share_s = NIGHTLY_S / sum(
            "rounds" in getattr(item, "fixturenames", ()) for item in request.session.items
        )
    return lambda at_least: counted(at_least, share_s, time.monotonic)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let fuzzers take their time at night, however few of them were chosen."""
    if config.getoption("nightly"):
        for item in items:
            if "rounds" in getattr(item, "fixturenames", ()):
                item.add_marker(pytest.mark.timeout(NIGHTLY_S + 120))
