"""A message, a drive and live faults pass few files of ours, and never climb from a lower package into ``deploy``."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import pytest

from bus.lockstep import WireFormat
from cell_firmware.faults.base import CellFault
from deploy.faults.registry import KINDS
from tests.tools.trace_tick import (
    FAULTS,
    LIMITS,
    PLANT,
    PROGRAMS,
    RECEIVER,
    ROOT,
    SENDER,
    WIRES,
    Mark,
    Route,
    live_fault,
    message_and_drive,
)

Traced = Callable[..., Any]
"""Calls a function in a process of its own: the profile function would see all that a process of many tests holds."""


@pytest.fixture(scope="module")
def traced() -> Iterator[Traced]:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        yield lambda trace, *arguments: pool.submit(trace, *arguments).result(100.0)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_message_passes_eleven_files_and_a_drive_fifteen(
    traced: Traced, program: str, wire: WireFormat
) -> None:
    message, drive = traced(message_and_drive, program, wire)
    assert (message.limit, drive.limit) == (11, 15)
    assert len(message.files) <= message.limit, message.paths
    assert len(drive.files) <= drive.limit, drive.paths
    assert message.over == {SENDER, RECEIVER}
    assert drive.over == {SENDER, PLANT}
    assert message.climbs == drive.climbs == []
    for route in (message, drive):
        sent = [file for file, _ in route.paths[SENDER]]
        assert sent[0] in ("cell_firmware/cell.py", "cell_firmware/firmware.py", "cell_firmware/board.py")
        assert sent[-1] == "bus/transports/memory.py"
    for route, thread in ((message, RECEIVER), (drive, PLANT)):
        assert route.paths[thread][0][0] == "bus/transports/memory.py"
    assert message.paths[RECEIVER][-1][0] in ("cell_firmware/plain_messages.py", "cell_firmware/board.py")
    assert drive.paths[PLANT][-1][0] == "plant/wheels.py"


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"add"}))
def test_a_live_fault_passes_fifteen_files_and_never_climbs(traced: Traced, kind: str) -> None:
    route = traced(live_fault, kind)
    assert route.limit == 15
    assert len(route.files) <= route.limit, route.paths
    assert route.climbs == [], route.paths
    asked = [file for file, _ in route.paths[PLANT]]
    assert asked[0] == "deploy/control/server.py"
    if not issubclass(KINDS[kind], CellFault):
        assert route.over == {PLANT}
        assert "plant/faults/schedule.py" in asked
        return
    assert route.over == {PLANT, SENDER, RECEIVER}
    assert asked[-1] == "bus/transports/memory.py"
    for cell in (SENDER, RECEIVER):
        struck = [file for file, _ in route.paths[cell]]
        assert struck[0] == "bus/transports/memory.py"
        assert struck[-1].startswith("cell_firmware/faults/")


def test_every_kind_of_fault_is_traced_that_can_be_injected() -> None:
    assert FAULTS.keys() == KINDS.keys() - {"add"}


def test_a_path_that_climbs_is_seen() -> None:
    bus, cells, control = "bus/lockstep/control.py", "cell_firmware/agent.py", "deploy/control/server.py"
    for files, climbs in (((control, bus, cells), []), ((bus, cells, bus, control), [control])):
        route = Route("fault", Mark((1,)), (), paths={SENDER: [(file, "f") for file in files]})
        assert route.climbs == climbs


def through_deploy() -> Route:
    """The route of a fault whose cells call back into ``deploy``, as they once did to decode it."""
    from cell_firmware.shard import Shard
    from deploy.scenes.errors import shown

    inject = Shard.inject

    def inject_through_deploy(self: Shard, fault: Any, site: Any, lattice: Any) -> None:
        shown(str(fault.fault))
        inject(self, fault, site, lattice)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Shard, "inject", inject_through_deploy)
        return live_fault("hang")


def test_a_call_from_a_lower_package_into_deploy_is_seen(traced: Traced) -> None:
    route = traced(through_deploy)
    assert set(route.calls_up) == {"deploy/scenes/errors.py"}
    assert "deploy/scenes/errors.py" in route.climbs


def test_the_page_shows_what_the_tool_prints() -> None:
    page = (ROOT / "docs" / "tick.md").read_text()
    _, _, section = page.partition("## Files that a message, a drive and a fault pass\n")
    command = "python tests/tools/trace_tick.py"
    assert f"`{command}`" in section
    shown = section.partition("```text\n")[2].partition("```")[0]
    printed = subprocess.run(
        [sys.executable, *command.split()[1:]],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    assert shown == printed.stdout
    assert LIMITS == {"message": 11, "drive": 15, "fault": 15}
