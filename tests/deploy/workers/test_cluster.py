"""Addresses of Dask clusters, and what is said of one that can't be used."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from deploy.cli import main
from deploy.errors import InputError
from deploy.workers.cluster import DaskCluster, scheduler_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:8786", "tcp://127.0.0.1:8786"),
        ("tcp://localhost:8786", "tcp://localhost:8786"),
        ("tcp://[::1]:8786", "tcp://[::1]:8786"),
        ("tls://10.0.0.5:8786", "tls://10.0.0.5:8786"),
        ("tls://[fd00::5]:8786", "tls://[fd00::5]:8786"),
    ],
)
def test_an_address_is_the_schedulers(text: str, address: str) -> None:
    assert scheduler_address(text, insecure=False) == address


@pytest.mark.parametrize(
    "text", ["10.0.0.5:8786", "tcp://10.0.0.5:8786", "ws://0.0.0.0:1", "tcp://[fd00::5]:1"]
)
def test_beyond_this_host_only_with_tls(text: str) -> None:
    with pytest.raises(InputError, match=r"leaves this host.*tls://.*--insecure"):
        scheduler_address(text, insecure=False)
    assert scheduler_address(text, insecure=True).endswith(text)


@pytest.mark.parametrize("text", ["", "here", "tcp://host", "tcp/127.0.0.1:8786", "tcp://a:1/b", "a b:1"])
def test_anything_else_is_no_address(text: str) -> None:
    with pytest.raises(InputError, match=r"--cluster .*: must be local, PROTOCOL://HOST:PORT"):
        scheduler_address(text, insecure=False)


def test_the_schedulers_file_names_it_under_the_same_rules(tmp_path: Path) -> None:
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"address": "tcp://127.0.0.1:1234", "workers": {}}))
    assert scheduler_address(str(file), insecure=False) == "tcp://127.0.0.1:1234"
    file.write_text(json.dumps({"address": "tcp://10.0.0.5:1234"}))
    with pytest.raises(InputError, match="leaves this host"):
        scheduler_address(str(file), insecure=False)
    file.write_text("[]")
    with pytest.raises(InputError, match="is no scheduler file"):
        scheduler_address(str(file), insecure=False)


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'mdms-emulator\[cluster\]'"):
        DaskCluster("127.0.0.1:1", 1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--cluster", "tls://a:1", "--jobs", "2"), "--jobs 2: the workers of --cluster tls://a:1 decide"),
        (("--insecure",), "--insecure: is for --cluster ADDRESS"),
        (("--cluster", "10.0.0.5:8786"), "--cluster 10.0.0.5:8786: leaves this host"),
    ],
)
def test_options_of_a_campaign_that_make_no_sense_are_refused_before_it_begins(
    arguments: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    asked = ("campaign", "elliptic", "--duration", "0.1", "--within", "1", "--fault", "crash")
    assert main([*asked, "--output", str(folder), *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not folder.exists()


def test_a_scheduler_that_doesnt_answer_is_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("deploy.workers.cluster._CONNECT_S", 0.2)
    with pytest.raises(InputError, match=r"--cluster tcp://127\.0\.0\.1:9: no scheduler answers"):
        DaskCluster("127.0.0.1:9", 1)
