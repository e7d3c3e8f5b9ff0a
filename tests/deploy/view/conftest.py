"""The browser and recordings for tests of the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from deploy.cli import main
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from tests.deploy.view.browser import chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FAULTS = (
    "faults=[{kind='crash',at_s=0.3,cell=[12,14]},"
    "{kind='wheel_stuck',at_s=0.4,until_s=0.7,rectangle=[[5,5],[6,7]]}]"
)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """One second of ``elliptic`` with two faults, and registers."""
    folder = tmp_path_factory.mktemp("view") / "run"
    command = ["run", "elliptic", "--duration", "1", "--set", FAULTS.replace("'", '"'), "--registers", "10"]
    more = ["--processes", "0", "--transport", "memory", "--no-picture", "-q", "--output", str(folder)]
    assert main([*command, *more]) == 0
    return load(Path(folder))
