"""``docs/accuracy.md``: everything that is measured about accuracy, in one page, made by one command."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib import metadata
from pathlib import Path

from deploy.errors import InputError
from deploy.studies.accuracy.experiments import chatter, continuum, graze, paper, sweep
from deploy.studies.accuracy.experiments.markdown import PICTURES, Section, prose, table
from deploy.util.files import write_text

FILE_NAME = "accuracy.md"
COMMAND = "mdms accuracy --docs"
REPEATS = 5
SECTIONS: Mapping[str, Callable[[int], Section]] = {
    "elliptic": partial(sweep.section, "elliptic", sampling=True),
    "coulomb": partial(sweep.section, "coulomb", sampling=False),
    "graze": graze.section,
    "chatter": chatter.section,
    "continuum": continuum.section,
    "paper": paper.section,
}
"""How each section is measured, by its name, in the order of the page; the argument is how often for a time."""
VERSIONS = ("numpy", "numba", "llvmlite", "scipy", "heyoka", "matplotlib")


def write(
    folder: Path,
    *,
    repeats: int = REPEATS,
    sections: Sequence[str] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Path:
    """Measure everything, and write the page and its pictures.

    All is measured before anything is written.

    Args:
        folder: For ``accuracy.md``; pictures go to ``images/accuracy`` in it.
        repeats: Runs for a time.
        sections: Which, the page then has no others; None: all.
        say: Told what is measured now.

    Returns:
        The page.

    Raises:
        InputError: There is no such section, or the folder can't be made.
        DeployError: It can't be written.
    """
    wanted = list(SECTIONS) if sections is None else sections
    unknown = [name for name in wanted if name not in SECTIONS]
    if unknown:
        raise InputError(f"section {unknown[0]}: there are {', '.join(SECTIONS)}")
    made: list[Section] = []
    for name in wanted:
        say(f"measuring {name} ...")
        made.append(SECTIONS[name](repeats))
    try:
        (folder / PICTURES).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: can't be made: {error.strerror or error}") from None
    for section in made:
        for file, draw in section.pictures.items():
            draw(folder / PICTURES / file)
    path = folder / FILE_NAME
    write_text(path, _page(made, repeats))
    return path


def _page(sections: Sequence[Section], repeats: int) -> str:
    parts = [f"## {section.title}\n\n{section.text.strip()}\n" for section in sections]
    return prose(
        "page", command=COMMAND, sections="\n".join(parts), facts=facts(VERSIONS), repeats=str(repeats)
    )


def facts(packages: Sequence[str]) -> str:
    """Machine, and versions of Python and of the packages that are installed, as a table."""
    rows = [("processor", f"{_processor()}, {os.cpu_count()} in all"), ("Python", platform.python_version())]
    for name in packages:
        with suppress(metadata.PackageNotFoundError):
            rows.append((name, metadata.version(name)))
    return table(("", ""), rows)


def _processor() -> str:
    """The model's name, where the system tells it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
