"""Every hard case is a test of every solver."""

from __future__ import annotations

import pytest

from tests.stability.solvers import SOLVERS, Solver


@pytest.fixture(params=SOLVERS)
def solver(request: pytest.FixtureRequest) -> Solver:
    """One of the solvers under test."""
    return SOLVERS[request.param]
