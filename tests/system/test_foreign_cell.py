"""A stranger's cell, a bare Zenoh client as printed in docs/bus.md, takes a cell's place."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from tests.system.joining import command
from tests.system.running import ROOT, Mdms, summary_of
from tests.system.test_keys import free_port

HEAT = """
duration_s = 0.4
[array]
rows = 3
columns = 6
[cells]
firmware = "heat_diffusion"
[cells.parameters]
diffusion_number = 0.2
held = [{ columns = [0, 0], speed_m_s = [0.3, -0.1] }]
[[parcels]]
size_m = [0.25, 0.15]
mass_kg = 1.0
position_m = [-0.1, 0.0]
[friction]
law = "viscous"
coefficient_s_per_m = 0.2
"""
CELL, SHARD = (1, 2), 8
GARBAGE = """
            if tick > 1:
                for bad in (b"\\xc1", msgpack.packb({"v": 2, "tick": tick - 1, "drive": [0.1, float("nan")]}),
                            msgpack.packb({"v": 2, "tick": tick + 50, "drive": [9.0, 9.0]}), msgpack.packb([1])):
                    puts[4].put(bad)
                puts[0].put(b"\\xc1")
"""


def client() -> str:
    """The program as the page prints it."""
    page = (ROOT / "docs" / "bus.md").read_text(encoding="utf-8")
    found = re.search(r"```python\n(\"\"\"A cell of a heat scene.*?)```", page, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_printed_client_is_short_and_imports_nothing_of_ours() -> None:
    names = {
        alias.name
        for node in ast.walk(ast.parse(client()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert names == {"msgpack", "queue", "sys", "time", "zenoh"}
    assert len(client().splitlines()) <= 40


@pytest.mark.slow
def test_a_run_with_a_strangers_cell_has_the_digest_of_one_without_whatever_else_it_puts(
    mdms: Callable[..., Mdms], tmp_path: Path
) -> None:
    scene = tmp_path / "heat.toml"
    scene.write_text(HEAT)
    near = RunOptions(0, "memory", output=tmp_path / "near", picture=False)
    expected = run(load_scene(str(scene)), near, quiet=True).summary
    rude = client().replace("            tick += 1\n", f"            tick += 1{GARBAGE}")
    assert rude != client()
    for text in (client(), rude):
        program = tmp_path / "cell.py"
        program.write_text(text)
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        # the stranger comes first, and the plant last
        options = [sys.executable, str(program), endpoint, "heat", *map(str, (*CELL, SHARD))]
        others = command(scene, endpoint, "each", "heat", [i for i in range(18) if i != SHARD])
        with (
            subprocess.Popen(options, stderr=subprocess.PIPE, text=True) as stranger,
            subprocess.Popen(others, cwd=ROOT, stderr=subprocess.PIPE, text=True) as cells,
        ):
            try:
                running = mdms(
                    "plant", scene, "--shards", "each", "--listen", endpoint, "--no-picture", "--json",
                    "--output", tmp_path / "out",
                )  # fmt: skip
                status, stdout, stderr = running.end(60.0)
                assert status == 0, stderr
                assert stranger.communicate(timeout=10.0)[1] == ""
                assert cells.communicate(timeout=10.0)[1] == ""
            finally:
                stranger.kill()
                cells.kill()
        assert cells.returncode == stranger.returncode == 0
        summary = summary_of(stdout)
        assert (summary["digest"], summary["cells_lost"]) == (expected.digest, [])
        counted = {(row["whose"], row["what"]): row["number"] for row in summary["refused"]}
        if text is rude:
            most = summary["ticks"] - 1
            assert {whose for whose, _ in counted} == {"cell 1,2"}
            assert counted["cell 1,2", "drive: encoding"] >= most
            assert counted["cell 1,2", "link: encoding"] >= most
            assert {"drive: finite", "drive: ahead", "drive: type"} <= {what for _, what in counted}
        else:
            assert counted == {}
