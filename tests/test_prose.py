"""The prose of docstrings keeps to the house's rules, and a public class name means one thing."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("bus", "cell_firmware", "deploy", "mdms", "plant")
OPENING = re.compile(r"^(What|Who|Whom|Whose|Where|When|Those|That|The same|Likewise)\b")
POINTING = re.compile(
    r"\b(it|its|they|them|their|those|that|these|this|one|ones|what|who|whom|whose|others|nothing|nobody)\b",
    re.I,
)
DENSE = 0.2
"""Greatest share of pointing words in a summary of eight words or more."""

DENSE_LEFT = 1
"""Summaries that are denser all the same; may only shrink."""

TWICE = {
    "Row": "a row of a table, one of each study",
    "Workspace": "a TypeVar of solvers",
    "Problem": "findings on firmware parameters, on faults and on scenes, each with its own path",
}
"""Public class names that several modules have, and why."""


def modules() -> Iterator[Path]:
    for package in PACKAGES:
        yield from sorted((ROOT / package).rglob("*.py"))


def summaries() -> Iterator[tuple[str, str]]:
    """Where each docstring stands, and its summary."""
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if text:
                    line = getattr(node, "lineno", 1)
                    yield f"{path.relative_to(ROOT)}:{line}", text.split("\n\n")[0]


def is_dense(summary: str) -> bool:
    words = len(summary.split())
    return words >= 8 and len(POINTING.findall(summary)) / words > DENSE


def test_no_summary_opens_with_a_word_that_only_points() -> None:
    assert [where for where, summary in summaries() if OPENING.match(summary)] == []


def test_no_summary_is_a_chain_of_semicolons() -> None:
    assert [where for where, summary in summaries() if summary.count(";") > 1] == []


def test_few_summaries_are_dense_with_pronouns() -> None:
    dense = [where for where, summary in summaries() if is_dense(summary)]
    assert len(dense) <= DENSE_LEFT, dense


def test_the_rules_bite() -> None:
    assert OPENING.match("What the plant tells a shard.")
    assert is_dense("Those of it that they who tell it what it is are told of.")


def test_a_public_class_name_means_one_thing() -> None:
    found: defaultdict[str, list[str]] = defaultdict(list)
    for path in modules():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(str(path.relative_to(ROOT)))
    twice = {name: places for name, places in found.items() if len(places) > 1}
    assert set(twice) <= set(TWICE), {name: places for name, places in twice.items() if name not in TWICE}


def test_the_top_of_deploy_is_its_entry_and_its_errors() -> None:
    assert {path.name for path in (ROOT / "deploy").glob("*.py")} == {"__init__.py", "cli.py", "errors.py"}
