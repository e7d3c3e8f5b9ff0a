"""A run with keys: who has none, or another's, or only a cell's, changes nothing, and is counted."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import msgpack
import pytest
import zenoh

from bus.transports.base import Received
from bus.transports.zenoh import Certificate, Identity, Password, client_config, open_client
from bus.wire.frames import Control, encode_control
from bus.wire.msgpack_codec import VERSION
from deploy.control.client import ask_run
from deploy.control.registers import read_registers
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.security.generate import generate_keys
from deploy.security.keyring import identity_of
from deploy.security.manifest import Kind
from deploy.workers.plan import RunOptions, plan
from tests.system.running import Mdms, summary_of

OTHERS = ("mdms/*/shard/1/sense", "mdms/*/shard/*/to/1")
"""What another process of cells hears."""

BLOCK = zenoh.CongestionControl.BLOCK
DURATION_S = 3.0
"""In step with the clock: so long do strangers have."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def keys_for(scene: Path, folder: Path, kind: Kind = "certificate") -> Path:
    made = plan(load_scene(str(scene)), RunOptions(2), "RUN")
    generate_keys(folder, made.scene, made.cut, kind, hosts=(), days=1, force=False)
    return folder


def refused(connect: str, identity: Identity | None, **more: str) -> bool:
    """Whether somebody is not let in, in bounded time."""
    config = client_config(connect, timeout_s=0.3, identity=identity)
    for key, value in more.items():
        cast("Any", config).insert_json5(key.replace("__", "/"), value)
    try:
        zenoh.open(config).close()
    except zenoh.ZError:
        return True
    return False


class Insider:
    """Somebody with the keys of shard 0, who tries what is not theirs."""

    def __init__(self, connect: str, identity: Identity) -> None:
        self.endpoint = open_client(connect, timeout_s=20.0, identity=identity)
        self.endpoint.subscribe("mdms/*/shard/0/sense")
        self.session = self.endpoint.session
        self.others = [self.session.declare_subscriber(key) for key in OTHERS]

    def act(self) -> None:
        own = self.endpoint.receive(20.0)
        assert isinstance(own, Received), "the run has not begun"
        run_name, sense = own.key.split("/")[1], own.payload
        token = self.session.liveliness().declare_token(f"mdms/{run_name}/shard/1/ready")
        stop = encode_control(Control("stop", 0, (), "by a stranger"))
        drive = msgpack.packb({"v": VERSION, "tick": 5, "drive": bytes(96)})
        tick = msgpack.unpackb(sense)["tick"]
        ahead = msgpack.packb({"v": VERSION, "tick": tick + 50, "drive": bytes(96)})
        puts = {"shard/1/drive": drive, "shard/0/sense": sense, "plant/control": stop}
        for _ in range(5):
            for key, payload in puts.items():
                self.put(f"mdms/{run_name}/{key}", payload)
            self.put(f"mdms/{run_name}/shard/0/drive", b"\xc1")
            self.put(f"mdms/{run_name}/shard/0/drive", ahead)
            self.put(f"mdms/{run_name}/shard/0/drive", bytes(100_000))
            self.session.delete(f"mdms/{run_name}/plant/control", congestion_control=BLOCK)
        replies = list(cast("Any", self.session).get(f"mdms/{run_name}/plant/operator", timeout=0.2))
        assert not any(reply.ok for reply in replies)
        del token

    def put(self, key: str, payload: bytes) -> None:
        self.session.put(key, payload, congestion_control=BLOCK)

    def close(self) -> None:
        heard = [cast("Any", other).try_recv() for other in self.others]
        self.endpoint.close()
        assert heard == [None, None]


@pytest.mark.slow
def test_strangers_and_insiders_are_refused_counted_and_shown_and_the_digest_stays(
    mdms: Callable[..., Mdms], small: Callable[..., Path], tmp_path: Path
) -> None:
    scene = small()
    mine, theirs = tmp_path / "mine", keys_for(scene, tmp_path / "theirs")
    status, stdout, stderr = mdms("keys", mine, scene, "--processes", 2, "--wire", "packed", "--json").end()
    assert (status, json.loads(stdout)["folder"], stderr) == (0, str(mine), "")
    listen, join = f"tls/127.0.0.1:{free_port()}", f"tls/127.0.0.1:{free_port()}"
    options = ("--processes", 2, "--duration", DURATION_S, "--keys", mine, "--no-picture", "--json")
    running = mdms("run", scene, *options, "--realtime", "--listen", listen, "--join", join)
    authority = str(mine / "operator" / "authority.pem")
    stolen = Certificate(
        authority, str(theirs / "operator" / "certificate.pem"), str(theirs / "operator" / "key.pem")
    )
    insider = Insider(join, identity_of(mine / "cells-0", "cells-0"))
    insider.act()
    assert ask_run(listen, {"op": "list"}, 5.0, mine)["ok"]
    assert (0, 0) in read_registers(listen, [(0, 0)], 5.0, mine / "operator").cells
    for endpoint in (listen, join):
        assert refused(endpoint.replace("tls", "tcp"), None)
        assert refused(endpoint, None, transport__link__tls=json.dumps({"root_ca_certificate": authority}))
        assert refused(endpoint, stolen)
        assert refused(endpoint, identity_of(theirs / "cells-0", "cells-0"))
    crossed = [
        open_client(join, identity=identity_of(mine / "operator", "operator")),
        open_client(listen, identity=identity_of(mine / "cells-1", "cells-1")),
    ]
    for endpoint in crossed:
        endpoint.subscribe("mdms/**")
    status, stdout, stderr = running.end()
    insider.close()
    assert status == 0, stderr
    for endpoint in crossed:
        assert endpoint.receive(0) is None
        endpoint.close()
    summary = summary_of(stdout)
    alone = run(
        load_scene(str(scene)).model_copy(update={"duration_s": DURATION_S}),
        RunOptions(0, "memory", output=tmp_path / "alone", picture=False),
        quiet=True,
    ).summary
    assert summary["digest"] == alone.digest
    told = {(row["why"], row["whose"], row["what"]): row["number"] for row in summary["refused"]}
    # Five puts of each of four kinds, five deletions, two subscriptions, a token, a query.
    assert told["denied", "cells-0", "message"] >= 5 * 5 + 2 + 1 + 1
    assert told["malformed", "shard 0", "drive: encoding"] == 5
    assert told["malformed", "shard 0", "drive: ahead"] == 5
    # An operator where cells join, and cells where operators connect.
    assert told["denied", "operator", "no role"] == told["denied", "cells-1", "no role"] == 1
    assert {whose for why, whose, _ in told if why == "denied"} == {
        "cells-0", "a stranger", "operator", "cells-1"
    }  # fmt: skip
    assert told["denied", "a stranger", "connection: it has no certificate"] >= 1
    assert sum(n for (_, whose, _), n in told.items() if whose == "a stranger") >= 2 * 4
    messages = [n for (why, _, what), n in told.items() if (why, what) == ("denied", "message")]
    assert summary["messages"]["denied"] == sum(messages)
    assert summary["messages"]["malformed"] == 10
    assert "mdms: denied: cells-0: message" in stderr
    assert "mdms: refused: shard 0: drive: encoding" in stderr


@pytest.mark.slow
def test_with_passwords_who_has_a_wrong_one_or_none_is_refused_and_counted(
    mdms: Callable[..., Mdms], small: Callable[..., Path], tmp_path: Path
) -> None:
    scene = small()
    mine = keys_for(scene, tmp_path / "mine", "password")
    listen = f"tcp/127.0.0.1:{free_port()}"
    running = mdms(
        "run", scene, "--processes", 2, "--keys", mine, "--duration", 2, "--realtime", "--join", listen
    )
    running.wait_until_recorded()
    assert refused(listen, None)
    assert refused(listen, Password("operator", "guessed"))
    assert refused(listen, Password("somebody", "guessed"))
    right = open_client(listen, identity=identity_of(mine / "cells-0", "cells-0"))
    right.session.put("mdms/any/plant/control", b"")
    status, stdout, stderr = running.end()
    right.close()
    assert status == 0, stderr
    assert "1 denied" in stdout
    for reason in ("it has no password", "a wrong password", "a user that is not in the file"):
        assert f"connection: {reason}" in " ".join(stdout.split())
        assert f"mdms: denied: a stranger: connection: {reason}" in stderr
