"""Compile kernels once, before any test: no test's time limit should have to hold a compiler's run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture import providers

from tests import specialisations

# The same examples every time, however slow the machine is: what fails once fails again.
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")

# Hypothesis also draws numbers that it reads in whatever modules of ours are loaded: the examples of a test would then
# hang on which others ran before it, and a failure could not be met again by running it alone.
providers._get_local_constants = lambda: providers._local_constants

WATCH = pytest.StashKey[specialisations.Watch]()
"""On what tests compile; not there where the run compiles as it goes."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of the nightly tier."""
    parser.addoption(
        "--nightly",
        action="store_true",
        help="all tests, the slow ones too; 200 random schedules, all solvers compared, fuzzers for ten minutes",
    )
    parser.addoption(
        "--compile-late",
        action="store_true",
        help="compile kernels where the first test needs them, not ahead",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Leave nothing out at night, unless told to."""
    if config.getoption("nightly") and config.option.markexpr == "not slow":
        config.option.markexpr = ""


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile kernels that are not on disk yet: processes that tests start find them there.

    All that the chosen tiers need where all tests are run. Who names files waits for the solvers alone.
    """
    config = session.config
    if hasattr(config, "workerinput"):
        known = config.workerinput["kernels"]
        if known is not None:
            config.stash[WATCH] = specialisations.Watch(known)
        return
    if config.option.collectonly or config.getoption("compile_late") or not specialisations.lasting():
        return
    whole = config.args_source is not pytest.Config.ArgsSource.ARGS and not config.option.keyword
    needed = specialisations.chosen(config.option.markexpr if whole else "not kernels and not slow")
    missing = specialisations.missing(needed)
    if missing:
        names = ", ".join(one.name for one in missing)
        config.get_terminal_writer().line(f"compiling kernels (once): {names} ...")
        specialisations.compile_ahead(missing)
    if whole:
        config.stash[WATCH] = specialisations.Watch(specialisations.listed(needed))


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell xdist's workers what they may use."""
    watch = node.config.stash.get(WATCH, None)
    node.workerinput["kernels"] = None if watch is None else watch.known


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail the test that uses a specialisation which is not listed, or which its tier doesn't compile."""
    try:
        return (yield)
    finally:
        watch = item.config.stash.get(WATCH, None)
        found = [] if watch is None else watch.found()
        assert not found, "\n".join(["not in tests/specialisations.py, or not for this tier:", *found])


FOLDERS = {
    "system": ("system",),
    "stability": ("stability",),
    "studies": (
        "deploy/studies/accuracy",
        "deploy/studies/campaign",
        "deploy/studies/effects",
        "deploy/studies/orientations",
    ),
    "kernels": ("plant", "deploy/checkpoints", "deploy/runs"),
}
"""Folders of a mark."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of a tier by their folder; ``slow`` and ``nightly`` are marked where a test stands."""
    late = (
        set() if config.getoption("nightly") else {one for one in items if one.get_closest_marker("nightly")}
    )
    if late:
        config.hook.pytest_deselected(items=list(late))
        items[:] = [one for one in items if one not in late]
    for item in items:
        for name, folders in FOLDERS.items():
            if any(Path(__file__).parent / folder in item.path.parents for folder in folders):
                item.add_marker(name)
