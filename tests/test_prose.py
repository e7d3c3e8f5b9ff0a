"""The prose of docstrings and pages keeps to the house's rules, and a public class name means one thing."""

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


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each paragraph, list item and table cell; code blocks are left out."""
    text: list[str] = []
    start, fenced = 0, False
    for number, line in enumerate([*page.read_text(encoding="utf-8").splitlines(), ""], 1):
        stripped = line.strip()
        if stripped.startswith("```"):
            fenced, stripped = not fenced, ""
        if fenced or (line.startswith("    ") and not text):
            continue
        begins = re.match(r"([-*>]|\d+\.) ", stripped)
        if text and (not stripped or begins or stripped.startswith(("#", "|"))):
            yield start, plain(" ".join(text))
            text = []
        if stripped.startswith("|"):
            for cell in re.split(r"(?<!\\)\|", stripped.strip("|")):
                yield number, plain(cell.strip())
        elif stripped and not stripped.startswith("#"):
            start = start if text else number
            text.append(stripped[begins.end() :] if begins else stripped)


def plain(text: str) -> str:
    """The words of Markdown: code is one word, a link is its text."""
    text = re.sub(r"`[^`]*`", "CODE", text)
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("*", "")


def sentences() -> Iterator[tuple[str, str]]:
    """Place and text of each sentence of the pages."""
    for page in pages():
        for line, text in blocks(page):
            for sentence in re.split(r"(?<=[.!?:])\s+(?=[A-Z])", text):
                yield f"{page.relative_to(ROOT)}:{line}", sentence


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


def test_no_sentence_of_a_page_opens_with_a_word_that_only_points() -> None:
    opened = [(at, text) for at, text in sentences() if OPENING.match(text) and not text.endswith("?")]
    assert opened == []


def test_no_sentence_of_a_page_is_dense_with_pronouns() -> None:
    assert [(at, text) for at, text in sentences() if is_dense(text)] == []


def test_no_paragraph_of_a_page_is_a_chain_of_semicolons() -> None:
    chains = [f"{page.name}:{line}" for page in pages() for line, text in blocks(page) if text.count(";") > 1]
    assert chains == []


def test_pages_are_read_as_paragraphs_items_and_cells(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# What\n\nOne `it;`\nline.\n- an [item](that.md)\n\n    code; code;\n\n| a | b |\n|---|---|\n"
    )
    assert list(blocks(page))[:2] == [(3, "One CODE line."), (5, "an item")]
    assert [text for _, text in blocks(page)][2:4] == ["a", "b"]


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
