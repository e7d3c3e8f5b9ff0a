"""The example notebook runs from top to bottom, and shows scenes, results and recordings."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

import mdms
from deploy.recordings.writer import Recorder
from tests.deploy.conftest import MadeUpRun

NOTEBOOK = Path(__file__).resolve().parents[1] / "docs" / "notebooks" / "recording.ipynb"


def shown(source: str, names: dict[str, Any]) -> Any:
    """Run a cell, and return the value of its last line as a notebook shows it."""
    tree = ast.parse(source)
    last = tree.body[-1]
    if not isinstance(last, ast.Expr):
        exec(compile(tree, "cell", "exec"), names)
        return None
    exec(compile(ast.Module(tree.body[:-1], []), "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


def html_of(value: Any) -> str:
    """The representation, which is well-formed."""
    text = value._repr_html_()
    ET.fromstring(text)
    return text


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    values = [shown("".join(cell["source"]), names) for cell in cells if cell["cell_type"] == "code"]
    scene, result, recording, weight, dataset, events = values
    assert "400 cells" in html_of(scene)
    assert "status" in html_of(result)
    assert recording.digest in html_of(recording)
    assert html_of(recording).count("<polyline") == 1
    assert weight == pytest.approx(2.0 * 9.81)
    assert dataset.sizes["cell"] == 400
    assert len(events) == 5


def test_a_scene_is_drawn_with_its_cells_and_parcels_and_text_is_escaped() -> None:
    text = html_of(mdms.load_scene("carousel").model_copy(update={"title": "<b>&"}))
    assert "&lt;b&gt;&amp;" in text
    assert text.count("<polygon") == 400 + 3
    # a large array is one rectangle
    assert html_of(mdms.load_scene("large")).count("<polygon") == 1 + 50


def test_a_recording_without_instants_has_a_representation(tmp_path: Path) -> None:
    Recorder(tmp_path, MadeUpRun().header).close("failed")
    assert "failed" in html_of(mdms.load_recording(tmp_path))
