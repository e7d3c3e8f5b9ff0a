"""Takes the pictures of the page of ``mdms view`` in the documentation.

``python tests/tools/view_pictures.py`` records runs of three scenes, of 18, 400 and 10,000 cells, opens the page over
each in headless chromium, light and dark, and writes the pictures to docs/images/view.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from deploy.cli import main as mdms  # noqa: E402
from deploy.recordings.reader import load  # noqa: E402
from deploy.view.replay import ReplaySource  # noqa: E402
from tests.deploy.view.browser import Watched, chromium, opened, served  # noqa: E402

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FAULTS = (
    'faults=[{ kind = "crash", at_s = 1.0, cell = [12, 14] }, '
    '{ kind = "wheel_stuck", at_s = 1.5, until_s = 4.0, rectangle = [[5, 5], [6, 7]] }]'
)


@dataclass(frozen=True)
class Picture:
    """A scene, options of its run, and commands of the page."""

    scene: str
    options: tuple[str, ...]
    commands: tuple[str, ...]


PICTURES = (
    Picture(
        "prototype",
        ("--duration", "6", "--registers", "5"),
        (
            "mdms.send('layer', {name: 'messages', on: true})",
            "mdms.send('seek', {time_s: 2.6})",
            "mdms.send('select_cell', {row: 1, column: 2})",
            "mdms.send('register', {name: 'speed_loop.duty'})",
        ),
    ),
    Picture(
        "elliptic",
        ("--duration", "6", "--set", FAULTS),
        (
            "mdms.send('layer', {name: 'coming', on: true})",
            "mdms.send('seek', {time_s: 1.6})",
            "mdms.send('select_parcel', {number: 0})",
        ),
    ),
    Picture(
        "large",
        ("--duration", "6"),
        ("mdms.send('seek', {time_s: 5})", "mdms.send('select_parcel', {number: 4})"),
    ),
)


def take(browser: Browser, url: str, picture: Picture, theme: str, path: Path) -> int:
    """Take a picture of the page; return the length of its file, bytes."""
    from PIL import Image

    with opened(browser, f"{url}?theme={theme}") as page:
        for command in picture.commands:
            page.page.evaluate(command)
        page.settled()
        _quiet(page)
        image = Image.open(io.BytesIO(page.page.screenshot()))
    image.convert("RGB").save(path, optimize=True)  # a palette would shift colours or show bands
    return path.stat().st_size


def _quiet(page: Watched) -> None:
    """Wait until the figures have been painted."""
    page.settled()
    page.page.wait_for_timeout(300)


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--output", type=Path, default=ROOT / "docs" / "images" / "view", help="folder to write to"
    )
    output = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for picture in PICTURES:
            place = str(Path(folder) / picture.scene)
            status = mdms(["run", picture.scene, *picture.options, "--no-picture", "-q", "--output", place])
            assert status == 0
            with served(ReplaySource(load(place))) as url:
                for theme in ("light", "dark"):
                    path = output / f"{picture.scene}-{theme}.png"
                    print(
                        f"{path.name}: {take(browser, url, picture, theme, path) / 1000:.0f} kB", flush=True
                    )


if __name__ == "__main__":
    main()
