"""Key expressions: their names are what other tools rely on."""

from __future__ import annotations

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import RunNameError
from bus.wire import keys


def test_the_keys_are_those_that_the_documentation_lists() -> None:
    assert keys.cell_key("r1", (3, 4), "sense") == "mdms/r1/cell/3/4/sense"
    assert keys.cell_key("r1", None, "drive") == "mdms/r1/cell/*/*/drive"
    assert [keys.cell_link_key("r1", (3, 4), side).rsplit("/", 2)[1:] for side in range(4)] == [
        ["to", "north"],
        ["to", "east"],
        ["to", "south"],
        ["to", "west"],
    ]
    assert keys.shard_key("r1", 2, "report") == "mdms/r1/shard/2/report"
    assert keys.shard_link_key("r1", 2, 3) == "mdms/r1/shard/2/to/3"
    assert keys.plant_key("r1", "control") == "mdms/r1/plant/control"


@pytest.mark.parametrize("run", ["a", "elliptic-7", "2026.11.21_a", "x" * 64])
def test_a_run_may_be_named_like_this(run: str) -> None:
    assert keys.check_run(run) == run


@pytest.mark.parametrize("run", ["", "a/b", "*", "a b", "-a", "x" * 65, "é", "a\n", "$*", "#"])
def test_a_run_may_not_be_named_like_that(run: str) -> None:
    with pytest.raises(RunNameError, match="run name"):
        keys.check_run(run)


CHUNK = st.sampled_from(["a", "b", "*", "**"])
EXPR = st.lists(CHUNK, min_size=1, max_size=5).map("/".join)


@given(EXPR, EXPR)
def test_expressions_meet_where_zenoh_says_so(a: str, b: str) -> None:
    one, other = zenoh.KeyExpr.autocanonize(a), zenoh.KeyExpr.autocanonize(b)
    assert keys.intersects(str(one), str(other)) == one.intersects(other)
