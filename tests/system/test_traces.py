"""Traced messages: what became of each, for every partition alike, without a change of the result."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Annotation

from deploy.cli import main
from deploy.errors import InputError
from deploy.plots.sequence import sequence_figure
from deploy.plots.spacetime import spacetime_figure
from deploy.recordings import run_log
from deploy.recordings.message_trace import TracedMessage
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.runs.run import Outcome, run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions
from tests.system.small import small_scene

TICKS = 49
_PROGRAM = '''
import numpy as np
from mdms import CellFirmware, CellOutputs


class Count(CellFirmware):
    """Sends the number of its tick to the north and east, as many neighbours as there are."""

    message = np.dtype([("count", "<u4")])

    def init(self, cell):
        return {"count": 0, "sides": [side for side in ("north", "east") if side in cell.neighbours]}

    def step(self, state, inputs):
        outbox = {side: {"count": state["count"]} for side in state["sides"]}
        return {**state, "count": state["count"] + 1}, CellOutputs((0.0, 0.0), outbox)
'''


@pytest.fixture
def counting(tmp_path: Path) -> Path:
    """A scene whose cells number their messages."""
    (tmp_path / "count.py").write_text(_PROGRAM)
    path = tmp_path / "counting.toml"
    path.write_text("""
duration_s = 0.2
[array]
rows = 3
columns = 4
[cells]
firmware = "count.py:Count"
[[parcels]]
size_m = [0.25, 0.15]
mass_kg = 1.0
position_m = [0.0, 0.0]
[friction]
law = "viscous"
coefficient_s_per_m = 0.2
""")
    return path


def traced(
    path: Path, extra: str = "", cells: str | None = "all", **options: Any
) -> tuple[Outcome, Recording, list[TracedMessage]]:
    """Run the scene with more of it, and return what was traced."""
    path.with_name("extra.toml").write_text(path.read_text() + extra)
    output = path.with_name(f"run-{len(list(path.parent.iterdir()))}")
    chosen = {"processes": 0, "transport": "memory", **options}
    outcome = run(
        load_scene(str(path.with_name("extra.toml"))),
        RunOptions(output=output, picture=False, trace_messages=cells, **chosen),
        quiet=True,
    )
    found = load(output)
    return outcome, found, found.traced_messages()


def fates(messages: list[TracedMessage]) -> Counter[str]:
    return Counter(message.fate for message in messages)


def test_messages_over_good_links_are_read_in_the_next_tick(counting: Path) -> None:
    _, _, messages = traced(counting)
    links = 3 * 3 + 4 * 2
    assert fates(messages) == {"read": links * (TICKS - 1), "under way": links}
    for message in messages:
        assert message.sent == {"count": message.sent_tick}
        if message.fate == "read":
            assert message.sent_tick is not None
            assert message.read_tick == message.sent_tick + 1
            assert message.read == message.sent
        row, column = message.sender
        there = {"north": (row + 1, column), "east": (row, column + 1)}
        assert message.receiver == there[message.side]
    assert all(message.why == "" for message in messages)


def test_lost_messages_are_those_that_the_summary_counts(counting: Path) -> None:
    outcome, _, messages = traced(counting, "[effects]\nlink_loss = { probability = 0.2 }\n")
    lost = [message for message in messages if message.fate == "lost"]
    assert len(lost) == outcome.summary.effects["link_loss.lost"] > 50
    assert {message.why for message in lost} == {"effects.link_loss"}
    assert all(message.read_tick is None and message.read == {} for message in lost)


def test_late_messages_name_the_tick_in_which_they_were_read(counting: Path) -> None:
    _, _, messages = traced(counting, "[effects]\nlink_delay = { ticks = 3 }\n")
    late = [message for message in messages if message.fate == "late"]
    assert len(late) == 17 * (TICKS - 4)
    assert {message.read_tick - message.sent_tick for message in late} == {4}  # pyright: ignore[reportOptionalOperand]
    assert {message.why for message in late} == {"effects.link_delay"}


@pytest.mark.parametrize(
    ("fault", "fate"),
    [
        ("kind = 'link_down', at_s = 0.05, until_s = 0.1", "lost"),
        ("kind = 'link_delay', at_s = 0.05, until_s = 0.1, ticks = 2", "late"),
        ("kind = 'link_corrupt', at_s = 0.05, until_s = 0.1, probability = 1.0", "altered"),
        ("kind = 'babble', at_s = 0.05, until_s = 0.1", "altered"),
    ],
)
def test_the_faults_of_the_time_are_named(counting: Path, fault: str, fate: str) -> None:
    _, _, messages = traced(counting, _fault(fault))
    found = [message for message in messages if message.fate == fate]
    assert found
    kind = fault.split("'")[1]
    assert all(f"fault {kind}" in message.why for message in found)
    assert all((1, 1) in (message.sender, message.receiver) for message in found)


def test_a_message_that_arrives_twice_is_told_twice(counting: Path) -> None:
    program = counting.with_name("count.py")  # a newer message would take the place of the second
    program.write_text(
        _PROGRAM.replace('in state["sides"]}', 'in state["sides"] if state["count"] % 2 == 0}')
    )
    _, _, messages = traced(
        counting, _fault("kind = 'link_duplicate', at_s = 0.05, until_s = 0.1, probability = 1.0")
    )
    again = [message for message in messages if message.fate == "repeated"]
    assert len(again) > 10
    assert {message.read_tick - message.sent_tick for message in again} == {2}  # pyright: ignore[reportOptionalOperand]
    assert {message.why for message in again} == {"fault link_duplicate"}


def _fault(fault: str) -> str:
    """A fault of one cell as a table of a scene."""
    return "[[faults]]\ncell = [1, 1]\n" + "\n".join(fault.split(", ")) + "\n"


def test_messages_between_chosen_cells_alone_are_told(counting: Path) -> None:
    _, found, messages = traced(counting)
    pair = {(0, 0), (0, 1)}
    between = [message for message in messages if {message.sender, message.receiver} == pair]
    chosen = found.traced_messages(pair)
    assert [one for one in chosen if {one.sender, one.receiver} == pair] == between
    assert all({one.sender, one.receiver} & pair for one in chosen)


def test_messages_to_a_dead_cell_are_lost_because_it_was_not_stepped(counting: Path) -> None:
    _, _, messages = traced(counting, "[[faults]]\nkind = 'crash'\nat_s = 0.1\ncell = [1, 1]\n")
    lost = [message for message in messages if message.fate == "lost"]
    assert {message.receiver for message in lost} == {(1, 1)}
    assert {message.why for message in lost} == {"the receiver was not stepped, fault crash"}


def test_of_a_link_with_one_traced_end_that_end_is_told(counting: Path) -> None:
    _, found, messages = traced(counting, cells="1,1")
    assert found.trace["cell"].tolist() == [[5]] * TICKS
    assert fates(messages) == {"not traced": 4 * TICKS - 2}
    sent = [message for message in messages if message.sender == (1, 1)]
    assert {(message.side, message.read_tick) for message in sent} == {("north", None), ("east", None)}
    read = [message for message in messages if message.receiver == (1, 1)]
    assert {message.sender for message in read} == {(0, 1), (1, 0)}
    assert all(message.read == {"count": message.read_tick - 1} for message in read)  # pyright: ignore[reportOptionalOperand]


@pytest.mark.slow
def test_a_trace_changes_nothing_and_is_the_same_for_every_partition(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(small_scene())
    extra = "[effects]\nlink_loss = { probability = 0.1 }\n"
    plain = traced(path, extra, cells=None)[0].summary.digest
    one, two, each = (traced(path, extra, processes=count, transport="zenoh") for count in (0, 2, "each"))
    assert {one[0].summary.digest, two[0].summary.digest, each[0].summary.digest} == {plain}
    for name, values in one[1].trace.items():
        np.testing.assert_array_equal(values, two[1].trace[name])
        np.testing.assert_array_equal(values, each[1].trace[name])
    assert not any(name.startswith("trace.") for name in one[1].registers)


@pytest.mark.slow
def test_messages_over_serial_lines_are_traced_whole(tmp_path: Path) -> None:
    scene = load_scene("prototype", [Override(("duration_s",), 0.3, "--duration")])
    output = tmp_path / "run"
    options = RunOptions(0, "memory", output=output, picture=False, trace_messages="all")
    run(scene, options, quiet=True)
    messages = load(output).traced_messages()
    assert fates(messages)["read"] + fates(messages)["late"] > 100
    assert all(set(message.sent or message.read) == set(messages[0].sent) for message in messages)


def test_a_chart_has_an_arrow_for_each_message_read_and_a_cross_for_each_lost(counting: Path) -> None:
    _, found, messages = traced(counting, _fault("kind = 'link_down', at_s = 0.05, until_s = 0.1"))
    figure = sequence_figure(found, "1,0-1,2", (8, 20))
    (axes,) = figure.axes
    between = [
        message
        for message in messages
        if message.sender[0] == message.receiver[0] == 1
        and max(message.sender[1], message.receiver[1]) <= 2
        and message.sent_tick is not None
        and 8 <= message.sent_tick <= 20
    ]
    arrows = [text for text in axes.texts if isinstance(text, Annotation)]
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert (len(arrows), len(crosses)) == (fates(between)["read"], fates(between)["lost"])
    assert len(crosses) > 10
    ends = {(float(x), float(y)) for x, y in (arrow.xy for arrow in arrows)}
    places = {column: float(number) for number, column in enumerate((0, 1, 2))}
    assert ends == {
        (places[message.receiver[1]], message.read_tick)
        for message in between
        if message.read_tick is not None
    }
    names = [text.get_text() for text in axes.texts if "," in text.get_text()]
    assert names == ["1,0", "1,1", "1,2"]


def test_a_space_time_plot_has_the_register_of_each_cell_beside_its_name(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(small_scene())
    _, found, _ = traced(path, cells=None, registers=1)
    figure = spacetime_figure(found, "firmware.speed_m_s", "1,0-1,3")
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["1,0", "1,1", "1,2", "1,3"]
    (mesh,) = axes.collections
    drawn = np.asarray(mesh.get_array()).reshape(4, -1)
    np.testing.assert_array_equal(drawn, found.registers["firmware.speed_m_s"][:, 4:8, 0].T)
    assert len(figure.axes) == 2, "the other component is zero all the time"


def test_no_more_is_traced_than_the_limit(counting: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = traced(counting)[1]
    a_tick = sum(values[0].nbytes for values in whole.trace.values())
    monkeypatch.setattr(run_log, "MESSAGES_LIMIT", 10 * a_tick + 1)
    assert traced(counting)[1].trace_tick.tolist() == list(range(10))


@pytest.mark.parametrize(
    ("cells", "problem"),
    [
        ("9,9", "--trace-messages 9,9: the array has no such cell"),
        ("1,1 x", "--trace-messages x: must be all, a cell's row and column"),
        (" ", "--trace-messages: names no cell"),
    ],
)
def test_cells_that_are_not_there_are_refused(counting: Path, cells: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        traced(counting, cells=cells)


def test_a_program_without_messages_has_none_to_trace() -> None:
    with pytest.raises(InputError, match="--trace-messages: the program of the cells sends no messages"):
        run(load_scene("elliptic"), RunOptions(trace_messages="all", picture=False), quiet=True)


def test_the_command_traces_and_draws(counting: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = counting.with_name("out")
    command = ["run", str(counting), "--processes", "0", "--transport", "memory", "--no-picture", "-q"]
    assert main([*command, "--output", str(output), "--registers", "--trace-messages", "0,0-1,1"]) == 0
    assert main(["plot", str(output), "--kind", "sequence", "--ticks", "4-9"]) == 0
    assert main(["plot", str(output), "--kind", "spacetime", "--cells", "1,0-1,3"]) == 0
    for name in ("sequence", "spacetime"):
        assert (output / f"{name}.png").stat().st_size > 5000
    capsys.readouterr()
    for wrong, problem in (
        (["--kind", "sequence", "--ticks", "9-4"], "--ticks 9-4: must be a first and a last tick"),
        (["--kind", "sequence", "--cells", "7,7"], "--cells 7,7: the array has no such cell"),
        (["--kind", "sequence", "--ticks", "0-900"], "a chart has room for 200 ticks, not 901"),
        (
            ["--kind", "sequence", "--cells", "2,2 2,3"],
            "--cells 2,2 2,3: no message of these cells was traced, but of 0,0 0,1 1,0 1,1",
        ),
        (
            ["--kind", "sequence", "--ticks", "90-99"],
            f"--ticks 90-99: the recording has a trace of the ticks 0 to {TICKS - 1}",
        ),
        (["--kind", "spacetime", "--register", "x"], "--register x: must be one of firmware.count"),
        (["--kind", "phase", "--cells", "1,1"], "--cells: goes with --kind sequence or spacetime, not phase"),
        (
            ["--kind", "sequence", "--register", "x"],
            "--register: goes with --kind spacetime or field, not sequence",
        ),
    ):
        assert main(["plot", str(output), *wrong]) == 2
        assert problem in " ".join(capsys.readouterr().err.split())
