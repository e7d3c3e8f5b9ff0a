"""The page about the hard cases says what is so, and no claim goes untested."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.stability.solvers import SOLVERS, SPEC, Claim, claims_table

HERE = Path(__file__).parent
TESTS = HERE.parent
PAGE = (HERE / "README.md").read_text(encoding="utf-8")
FILES = sorted(HERE.glob("test_*.py"))


def _cases(file: Path) -> dict[str, ast.FunctionDef]:
    """The tests of a file."""
    body = ast.parse(file.read_text(encoding="utf-8")).body
    return {
        node.name: node for node in body if isinstance(node, ast.FunctionDef) and node.name[:5] == "test_"
    }


def _told() -> list[tuple[Path, str]]:
    """Every test that the page's tables name, with its file: the one named last before it."""
    told: list[tuple[Path, str]] = []
    file = HERE
    for word in re.findall(r"`((?:[\w/]+/)?test_\w+(?:\.py)?)`", PAGE):
        if word.endswith(".py"):
            file = TESTS / word.removeprefix("tests/") if "/" in word else HERE / word
        else:
            told.append((file, word))
    return told


def test_every_test_that_the_page_names_exists() -> None:
    missing = [(file.name, name) for file, name in _told() if name not in _cases(file)]
    assert missing == []


def test_the_page_names_every_hard_case_once_or_more() -> None:
    told = set(_told())
    there = {(file, name) for file in FILES if file.name != Path(__file__).name for name in _cases(file)}
    assert {name for file, name in there if (file, name) not in told} == set()


def test_the_page_s_table_of_claims_is_that_of_the_solvers() -> None:
    assert claims_table() in PAGE, claims_table()


def test_every_solver_that_a_scene_can_ask_for_is_put_to_the_cases() -> None:
    known = set(SPEC.json_schema()["discriminator"]["mapping"])
    assert {solver.settings["name"] for solver in SOLVERS.values()} == known


@pytest.mark.parametrize("claim", Claim, ids=lambda claim: claim.name)
def test_every_claim_is_made_by_a_solver_and_taken_by_a_case(claim: Claim) -> None:
    assert any(solver.claims(claim) for solver in SOLVERS.values())
    assert any(f"Claim.{claim.name}" in ast.unparse(one) for _, one in _decorators())


def _decorators() -> list[tuple[str, ast.expr]]:
    return [
        (name, one) for file in FILES for name, case in _cases(file).items() for one in case.decorator_list
    ]


def test_a_case_that_takes_a_solver_says_what_it_needs_and_none_is_skipped() -> None:
    """``claiming`` gives it every solver that claims as much; only a package that isn't installed may skip one."""
    claimed = {name for name, one in _decorators() if ast.unparse(one).startswith("claiming(Claim.")}
    for file in FILES:
        for name, case in _cases(file).items():
            takes = "solver" in {argument.arg for argument in case.args.args}
            assert takes == (name in claimed), name
        text = file.read_text(encoding="utf-8")
        assert not re.search(
            r"pytest\.(mark\.)?(skip|xfail|importorskip)", text.replace("(skip|xfail|importorskip)", "")
        )
