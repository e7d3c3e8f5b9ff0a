"""The page on accuracy: what stands in it is what the code makes, and it is whole or not there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from deploy.cli import main
from deploy.errors import InputError
from deploy.studies.accuracy import page
from deploy.studies.accuracy.experiments.markdown import Section, error, milliseconds, power, prose

DOCS = Path(__file__).resolve().parents[4] / "docs"
_TIME = re.compile(r"[\d,.]+ ms\b")
_ROUNDING = re.compile(r"\d\.\de-1[4-9]\b")


def _lasting(text: str) -> str:
    """Without times, and without errors that are rounding: another machine has others."""
    return _ROUNDING.sub("~0", _TIME.sub("… ms", text))


@pytest.mark.parametrize("name", ["continuum", "paper"])
def test_the_page_says_what_the_code_makes_now(name: str) -> None:
    section = page.SECTIONS[name](1)
    written = (DOCS / page.FILE_NAME).read_text(encoding="utf-8")
    assert _lasting(section.text.strip()) in _lasting(written)
    for file in section.pictures:
        assert (DOCS / "images" / "accuracy" / file).stat().st_size > 10_000


def test_every_section_is_in_the_page_once() -> None:
    written = (DOCS / page.FILE_NAME).read_text(encoding="utf-8")
    assert written.count("\n## ") == len(page.SECTIONS) + 1


def _made(name: str) -> Section:
    return Section(f"Title of {name}", "Text, 12.3 ms.", {f"{name}.png": Path.touch})


def test_page_and_pictures_are_written_in_the_order_of_the_sections(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "SECTIONS", {name: lambda _, name=name: _made(name) for name in ("one", "two")})
    said: list[str] = []
    path = page.write(tmp_path / "docs", repeats=2, sections=("two", "one"), say=said.append)
    text = path.read_text(encoding="utf-8")
    assert text.index("## Title of two\n\nText, 12.3 ms.") < text.index("## Title of one")
    assert "medians of 2 rounds" in text
    assert "| numpy |" in text
    assert "processor" in text
    assert [line.split()[1] for line in said] == ["two", "one"]
    assert sorted(file.name for file in (tmp_path / "docs" / "images" / "accuracy").iterdir()) == [
        "one.png",
        "two.png",
    ]


def test_nothing_is_written_where_a_measurement_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: int) -> Section:
        raise ArithmeticError

    monkeypatch.setattr(page, "SECTIONS", {"one": lambda _: _made("one"), "two": fails})
    with pytest.raises(ArithmeticError):
        page.write(tmp_path / "docs", sections=("one", "two"))
    assert not (tmp_path / "docs").exists()


def test_an_unknown_section_and_a_folder_that_is_a_file_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="there are elliptic, coulomb, graze, chatter, continuum, paper"):
        page.write(tmp_path, sections=("grace",))
    monkeypatch.setattr(page, "SECTIONS", {"one": lambda _: _made("one")})
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can't be made"):
        page.write(tmp_path / "file", sections=("one",))


def test_the_page_is_written_by_a_command_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(page, "SECTIONS", {"one": lambda _: _made("one")})
    monkeypatch.chdir(tmp_path)
    assert main(["accuracy", "--docs"]) == 0
    assert capsys.readouterr().out == "docs/accuracy.md\n"
    assert main(["accuracy", "--docs", "elsewhere", "--repeats", "2", "--quiet"]) == 0
    assert "medians of 2 rounds" in (tmp_path / "elsewhere" / "accuracy.md").read_text(encoding="utf-8")
    capsys.readouterr()
    assert main(["accuracy", "elliptic", "--docs"]) == 2
    assert "takes no SCENE" in capsys.readouterr().err
    assert main(["accuracy"]) == 2
    assert "which SCENE?" in capsys.readouterr().err


def test_words_of_the_page_are_all_given_their_numbers() -> None:
    with pytest.raises(KeyError):
        prose("continuum", length="1")


@pytest.mark.parametrize(
    ("value", "written"), [(1e-6, "1e-6"), (1e-12, "1e-12"), (0.0001, "1e-4"), (2.5e-3, "0.0025"), (1.0, "1")]
)
def test_a_setting_is_written_as_one_would(value: float, written: str) -> None:
    assert power(value) == written


def test_errors_have_two_digits_and_times_their_unit() -> None:
    assert [error(value) for value in (1.449e-5, 3e-16, 0.0, 0.12)] == ["1.4e-5", "3.0e-16", "0", "1.2e-1"]
    assert [milliseconds(value) for value in (1.2345e-3, 0.0456, 0.2, 12.0)] == [
        "1.23 ms",
        "45.6 ms",
        "200 ms",
        "12,000 ms",
    ]
