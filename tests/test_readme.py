"""The front page and the pages under ``docs/`` say what is so."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from deploy.scenes.files import bundled_names

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "tests").rglob("README.md")),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_of_a_page_leads_somewhere(page: Path) -> None:
    links = re.findall(r"\]\((?!https?://|#)([^)#\s]+)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if not (page.parent / link).exists()]
    assert missing == []


def test_the_readme_lists_the_bundled_scenes() -> None:
    table = README[README.index("| bundled scene |") :].partition("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == set(bundled_names())


def test_the_readme_s_firmware_passes_a_parcel_on_to_the_next_cell(tmp_path: Path) -> None:
    code = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert code is not None
    (tmp_path / "conveyor.py").write_text(code[1], encoding="utf-8")
    spec = CellsSpec(firmware=str(tmp_path / "conveyor.py"))
    lattice = Lattice((0, column) for column in range(3))
    cells = Cells.of(lattice, np.stack((0.1 * lattice.columns, 0.1 * lattice.rows), axis=1), spec.period_s)
    shard = Shard(Board(load(spec)), cells, Partition.even(lattice, 1), 0)
    parcel = np.array([[True], [False], [False]])
    assert shard.step(0, parcel).drive[:, 0].tolist() == [0.2, 0.0, 0.0]
    assert shard.step(1, parcel).drive[:, 0].tolist() == [0.2, 0.2, 0.0]
