"""Transports for the tests of the bus."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.bus.support import Network


@pytest.fixture(params=["memory", "zenoh", "zenoh, direct"])
def network(request: pytest.FixtureRequest) -> Iterator[Network]:
    """Each transport in turn."""
    network = Network(request.param)
    yield network
    network.close()


@pytest.fixture
def memory() -> Iterator[Network]:
    """The memory transport."""
    network = Network("memory")
    yield network
    network.close()
