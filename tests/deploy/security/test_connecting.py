"""Cells let nobody stand for the plant but the plant, under the names that its certificate has."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bus.errors import TransportError
from bus.transports.zenoh import AccessPolicy, Certificate, Identity, hub_config, open_client
from deploy.security.certificates import Authority, CertificatePair

Opened = Callable[[Identity], str]


@pytest.fixture
def listening() -> Iterator[Opened]:
    """Opens somebody's session that listens on loopback; returns where."""
    opened: list[Any] = []

    def listen(identity: Identity) -> str:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            where = f"tls/127.0.0.1:{probe.getsockname()[1]}"
        opened.append(zenoh.open(hub_config(where, gate=AccessPolicy(identity, '{"enabled": false}'))))
        return where

    yield listen
    for session in opened:
        session.close()


def test_who_has_a_cell_s_certificate_or_another_host_s_is_not_taken_for_the_plant(
    listening: Opened, tmp_path: Path
) -> None:
    authority = Authority(1)

    def written(name: str, made: CertificatePair) -> Certificate:
        files = {"authority": authority.certificate, "certificate": made.certificate, "key": made.key}
        for part, content in files.items():
            (tmp_path / f"{name}-{part}").write_bytes(content)
        return Certificate(*(str(tmp_path / f"{name}-{part}") for part in files))

    cell = written("cell", authority.client("cells-0"))
    plant = listening(written("plant", authority.server("plant", ["127.0.0.1"])))
    open_client(plant, identity=cell).close()
    for impostor in (written("other", authority.server("plant", ["10.0.0.5"])), cell):
        where = listening(impostor)
        with pytest.raises(TransportError, match="the run refuses these keys"):
            open_client(where, identity=cell, timeout_s=0.2)
