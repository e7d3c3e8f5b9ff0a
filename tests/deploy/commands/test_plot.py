"""``mdms plot`` draws a recording, or says in one line why not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deploy.cli import main

Make = Callable[..., Any]
PNG = b"\x89PNG\r\n"


def test_the_picture_lands_beside_the_recording_and_its_path_is_printed(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    made_up_run().record(tmp_path)
    assert main(["plot", str(tmp_path)]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "overview.png")
    assert (tmp_path / "overview.png").read_bytes().startswith(PNG)


def test_the_picture_goes_where_output_says(tmp_path: Path, made_up_run: Make) -> None:
    path = made_up_run().record(tmp_path)
    assert main(["plot", str(path), "--output", str(tmp_path / "mine.png")]) == 0
    assert (tmp_path / "mine.png").read_bytes().startswith(PNG)
    assert not (tmp_path / "overview.png").exists()


def test_output_may_be_an_svg_or_a_pdf_and_nothing_else(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made_up_run().record(tmp_path)
    assert main(["plot", str(path), "--output", str(tmp_path / "p.pdf")]) == 0
    assert (tmp_path / "p.pdf").read_bytes().startswith(b"%PDF-")
    assert main(["plot", str(path), "--output", str(tmp_path / "p.jpg")]) == 2
    assert "p.jpg: a plot's name must end in .png, .svg or .pdf" in capsys.readouterr().err
    assert not (tmp_path / "p.jpg").exists()


def test_a_recording_that_was_cut_is_drawn(tmp_path: Path, made_up_run: Make) -> None:
    path = made_up_run().record(tmp_path)
    path.write_bytes(path.read_bytes()[:-300])
    assert main(["plot", str(path)]) == 0


def test_a_missing_recording_is_bad_input_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", str(tmp_path / "none.mcap")]) == 2
    error = capsys.readouterr().err
    assert "can't read the recording" in error
    assert len(error.splitlines()) == 1


def test_a_file_of_another_kind_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("not a recording")
    assert main(["plot", str(tmp_path / "notes.txt")]) == 2
    assert "is not a recording" in capsys.readouterr().err


def test_an_output_that_can_t_be_written_fails(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made_up_run().record(tmp_path)
    assert main(["plot", str(path), "--output", str(tmp_path / "absent" / "x.png")]) == 1
    assert "can't write " in capsys.readouterr().err


def test_an_unknown_kind_of_picture_is_bad_input(tmp_path: Path, made_up_run: Make) -> None:
    made_up_run().record(tmp_path)
    assert main(["plot", str(tmp_path), "--kind", "hologram"]) == 2
