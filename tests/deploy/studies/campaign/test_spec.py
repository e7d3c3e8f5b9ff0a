"""What a campaign's folder keeps of what was asked."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy import cli
from deploy.errors import InputError
from deploy.scenes.files import scene_text
from deploy.studies.campaign.spec import (
    CampaignSpec,
    check_programs,
    check_same,
    check_versions,
    read,
    read_options,
    write,
)
from deploy.util.files import versions

PROGRAM = """
from mdms import CellFirmware, CellOutputs

class East(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return state, CellOutputs((0.1, 0.0))
"""
SPEC = read_options(
    {
        "scene": "a b/ä.toml",
        "folder": "/home",
        "set": ('title="say \\"so\\""', "x=\x7f\t𝄞"),
        "fault": "crash",
        "share": "0:0.5:0.1",
        "at_s": 0.1,
        "limit_s": 1e-5,
    }
)


def test_a_written_specification_is_read_unchanged(tmp_path: Path) -> None:
    programs = {'/a "b"/ä.py:P': "12ab", "wave": "34cd"}
    write(SPEC, "the = 'scene'\n", {"numpy": "2.1"}, programs, tmp_path)
    assert read(tmp_path) == (SPEC, "the = 'scene'\n", {"numpy": "2.1"}, programs)


def test_going_on_with_the_same_or_nothing_said_is_fine() -> None:
    check_same(SPEC, {"scene": None, "fault": "crash", "set": SPEC.set, "at_s": 0.1}, Path("d"))


def test_going_on_with_anything_else_is_refused_and_names_all_of_it() -> None:
    given = {"scene": "heat", "fault": "crash", "seeds": "20", "vary": ("a=1",), "at_s": 2.0}
    with pytest.raises(InputError) as refused:
        check_same(SPEC, given, Path("d"))
    assert str(refused.value).splitlines() == [
        "--resume d: SCENE heat: the campaign has a b/ä.toml",
        "--resume d: --seeds 20: the campaign has 10",
        "--resume d: --vary a=1: the campaign has none",
        "--resume d: --at 2.0: the campaign has 0.1",
    ]


def test_other_versions_are_refused_by_name() -> None:
    before = {"numpy": "2.1", "numba": "0.62"}
    check_versions(before, dict(before), Path("d"))
    with pytest.raises(InputError, match=r"numpy 2\.1, now 2\.2: .*--other-versions"):
        check_versions(before, {**before, "numpy": "2.2"}, Path("d"))


def test_other_programs_are_refused_by_name() -> None:
    check_programs({"a.py": "1", "b.py": "2"}, {"a.py": "1", "b.py": "2"}, Path("d"))
    check_programs({}, {"a.py": "1"}, Path("d"))  # a campaign of before that stored none
    with pytest.raises(
        InputError, match=r"--resume d: the program has changed since the campaign began: b\.py: "
    ):
        check_programs({"a.py": "1", "b.py": "2"}, {"a.py": "1", "b.py": "3"}, Path("d"))


def test_a_campaign_of_a_program_that_was_edited_is_not_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program, folder = tmp_path / "east.py", tmp_path / "campaign"
    program.write_text(PROGRAM)
    folder.mkdir()
    sets = (f'cells={{firmware="{program}"}}',)
    spec = read_options({"scene": "elliptic", "set": sets, "within_m": 0.1, "fault": "crash", "share": "0"})
    write(spec, scene_text("elliptic"), versions(), {str(program): "that of before"}, folder)
    assert cli.main(["campaign", "--resume", str(folder), "--quiet"]) == 2
    assert f"the program has changed since the campaign began: {program}: " in capsys.readouterr().err
    assert not (folder / "runs.jsonl").exists()


def test_a_folder_without_a_campaign_or_with_a_spoilt_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no campaign there: campaign\.toml is missing"):
        read(tmp_path)
    write(CampaignSpec(scene="heat"), "", {}, {}, tmp_path)
    path = tmp_path / "campaign.toml"
    path.write_text(path.read_text().replace("seeds", "seed_s"))
    with pytest.raises(InputError, match=r"seed_s .*unknown key; nearest: seeds"):
        read(tmp_path)
