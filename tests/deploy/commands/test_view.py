"""``mdms view``: what is refused before anything starts."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from deploy import cli


def test_a_port_in_use_is_refused_before_a_run_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.socket() as used:
        used.bind(("127.0.0.1", 0))
        used.listen()
        port = used.getsockname()[1]
        assert cli.main(["view", "elliptic", "--no-browser", "--port", str(port)]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"--port {port}: Address already in use\n")
    assert list(tmp_path.iterdir()) == []
