"""Standard streams whose encoding lacks characters: nothing is lost, no JSON or TOML is broken."""

from __future__ import annotations

import io
import json
import os
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest

from deploy import cli

SCENE = """
title = "Förderband – 5 µm"
duration_s = 0.008192
array = { rows = 2, columns = 2 }
cells = { parameters = { field = { kind = "uniform", velocity_m_s = [0.1, 0.0] } } }
friction = { law = "viscous", coefficient_s_per_m = 0.5 }
"""


class Printed(NamedTuple):
    status: int
    stdout: bytes
    stderr: bytes


def mdms(monkeypatch: pytest.MonkeyPatch, encoding: str, *arguments: str) -> Printed:
    """Run the command in this process, as under a locale of that encoding."""
    streams = {name: io.TextIOWrapper(io.BytesIO(), encoding) for name in ("stdout", "stderr")}
    with monkeypatch.context() as patch:
        for name, stream in streams.items():
            patch.setattr(sys, name, stream)
        status = cli.main(arguments)
    for stream in streams.values():
        stream.flush()
    return Printed(status, *(stream.buffer.getvalue() for stream in streams.values()))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "förder.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("encoding", "times"), [("ascii", b"x"), ("latin-1", b"\xd7"), ("utf-8", "×".encode())]
)
def test_a_run_is_told_in_every_encoding(
    scene: Path, tmp_path: Path, encoding: str, times: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = ("--processes", "0", "--transport", "memory", "--no-picture", "--output", str(tmp_path / "out"))
    done = mdms(monkeypatch, encoding, "run", str(scene), *where)
    assert (done.status, done.stderr) == (0, b"")
    assert b" " + times + b" real time" in done.stdout


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_printed_scene_is_toml_in_every_encoding(
    scene: Path, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = mdms(monkeypatch, encoding, "scenes", str(scene))
    assert tomllib.loads(done.stdout.decode("utf-8"))["title"] == "Förderband – 5 µm"


def test_json_is_json_in_every_encoding(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    where = ("--processes", "0", "--transport", "memory", "--no-picture", "--output", str(tmp_path / "out"))
    done = mdms(monkeypatch, "ascii", "run", str(scene), "--json", *where)
    assert json.loads(done.stdout)["scene"] == str(scene)


def test_an_error_spells_what_stderr_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    done = mdms(monkeypatch, "ascii", "run", "fö×")
    assert done.status == 2
    assert done.stderr.startswith(rb"scene f\xf6x: neither a bundled scene nor a file")


def test_a_name_that_is_no_text_is_refused_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = os.fsdecode(os.fsencode(tmp_path) + b"/b\xff.toml")
    Path(name).write_text(SCENE, encoding="utf-8")
    done = mdms(monkeypatch, "utf-8", "run", name)
    assert done.status == 2
    assert done.stderr.endswith(
        b"b\xff.toml: is no text in utf-8: rename the file, or set a locale: LC_ALL=C.UTF-8\n"
    )
