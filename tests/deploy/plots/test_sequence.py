"""Labels of a message sequence chart."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.plots.sequence import _words


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"u": 0.123456, "here": True}, "0.123 True"),
        ({"at": [0.1 + 0.2, 2.0], "n": 7}, "[0.3,2] 7"),
        ({"route.length": 2, "route.items": [5, -6, 0, 0]}, "[5,-6]"),
        ({"length": 3}, "3"),  # no list
        ({"key": 2**63 + 5}, "9.22e+18"),
        ({"a": 1234567, "b": 1234567, "c": 1234567, "d": 1234567, "e": 1}, "1234567 1234567\n1234567…"),
    ],
)
def test_a_label_is_two_short_lines(values: dict[str, Any], words: str) -> None:
    assert _words(values) == words
    assert all(len(line) <= 16 for line in words.splitlines())
