"""Pictures of the documentation: every scene in the gallery, every size and theme of the page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from deploy.scenes.files import bundled_names, load_scene
from tests.tools.gallery import page

DOCS = Path(__file__).parents[1] / "docs"


def test_the_gallery_has_a_thumbnail_of_every_bundled_scene_and_is_as_its_command_makes_it() -> None:
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert text == page(), "run python tests/tools/gallery.py"
    shown = re.findall(r"!\[(\w+)\]\((images/gallery/\w+\.png)\)", text)
    assert [name for name, _ in shown] == list(bundled_names())
    for _, path in shown:
        with Image.open(DOCS / path) as picture:
            assert picture.width == 300


@pytest.mark.parametrize(("scene", "cells"), [("prototype", 18), ("elliptic", 400), ("large", 10_000)])
def test_the_page_is_shown_at_three_sizes_light_and_dark(scene: str, cells: int) -> None:
    assert len(load_scene(scene).lattice()) == cells
    text = (DOCS / "view.md").read_text(encoding="utf-8")
    for theme in ("light", "dark"):
        assert f"(images/view/{scene}-{theme}.png)" in text
        with Image.open(DOCS / "images" / "view" / f"{scene}-{theme}.png") as picture:
            assert picture.size == (1280, 800)
