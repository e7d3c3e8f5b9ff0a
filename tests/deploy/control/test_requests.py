"""What can be asked of a running system, and what it says of what can't."""

from __future__ import annotations

import json

import pytest

from deploy.control.server import read_request
from deploy.errors import RequestError


def test_of_a_request_with_thousands_of_problems_some_are_reported_and_the_others_counted() -> None:
    fault = {"kind": "crash", "cell": [1, 1], **{f"k{i}": 0 for i in range(4000)}}
    with pytest.raises(RequestError) as caught:
        read_request(json.dumps({"op": "inject", "fault": fault}).encode())
    assert len(caught.value.problems) == 21
    assert caught.value.problems[0].startswith("fault.k0 = 0: unknown key")
    assert caught.value.problems[-1] == "and 3980 more"
    assert len(json.dumps(caught.value.problems)) < 65_536


@pytest.mark.parametrize(
    "payload", [None, b" " * 65_537, b"\xff", b"[" * 60_000, b"", b"[]", b'{"op": ["list"]}']
)
def test_what_is_no_request_is_refused_in_words(payload: bytes | None) -> None:
    with pytest.raises(RequestError, match=r"^(a request|request|op)\b"):
        read_request(payload)


def test_add_is_refused_live_and_what_to_do_instead_is_said() -> None:
    request = {"op": "inject", "fault": {"kind": "add", "cell": [1, 1]}}
    with pytest.raises(RequestError, match="inject remove, and repair that fault"):
        read_request(json.dumps(request).encode())


def test_a_request_is_read_that_is_as_long_as_may_be_and_no_longer() -> None:
    request = b'{"op": "list"}'
    assert read_request(request.ljust(65_536)).op == "list"
    with pytest.raises(RequestError, match="must be at most 65536 bytes"):
        read_request(request.ljust(65_537))


def test_of_twenty_problems_all_are_reported() -> None:
    fault = {"kind": "crash", "cell": [1, 1], **{f"k{i}": 0 for i in range(20)}}
    with pytest.raises(RequestError) as caught:
        read_request(json.dumps({"op": "inject", "fault": fault}).encode())
    assert len(caught.value.problems) == 20
    assert all("unknown key" in problem for problem in caught.value.problems)
