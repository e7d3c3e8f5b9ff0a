"""Exports give back every value of a recording, and leave no half-written file."""

from __future__ import annotations

import csv
import json
import math
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import xarray as xr
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from deploy.cli import main
from deploy.errors import InputError
from deploy.plots.kinds import draw_kind
from deploy.recordings.exports.registry import EXPORTS, export_recording
from deploy.recordings.format import PARCEL_NUMBERS
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.recordings.writer import Recorder
from deploy.runs.output_folder import remove_results

Make = Callable[..., Any]
TIERED = [pytest.param(to, marks=[pytest.mark.slow] if to == "netcdf" else []) for to in EXPORTS]
EVENTS = [
    {
        "time_s": 0.01,
        "kind": "fed",
        "parcel": 1,
        "cells": [[0, 1]],
        "position_m": [0.1, -0.0],
        "detail": "in",
    },
    {"time_s": 0.0307, "kind": "left", "parcel": 0, "cells": [], "position_m": None, "detail": "north, 5"},
    {"time_s": 0.031, "kind": "overlap", "parcel": None, "cells": [], "position_m": [1.0, 1e-300]},
]
FAULTS = [
    {"time_s": 0.0, "kind": "timed_out", "cell": [0, 1], "tick": 0, "detail": 'a "quoted"\nline'},
    {"time_s": 0.02, "kind": "link_loss", "phase": "begins", "cells": [[1, 1]], "number": 3, "tick": 5},
]


@pytest.fixture
def recording(tmp_path: Path, made_up_run: Make) -> Recording:
    run = made_up_run(
        parcels=2, sensors=3, wheels_change=True, extra={"own_parcels": 1}, events=EVENTS, faults=FAULTS
    )
    run.states[3, 0] = [-0.0, 5e-324, 0.1, 1 / 3, math.inf, math.nan]
    with Recorder(tmp_path / "run", run.header) as recorder:
        run.feed(recorder)
        for tick in (4, 8):
            registers = {
                "firmware.u": np.arange(24.0).reshape(12, 2) / tick,
                "n/a": np.arange(12, dtype=np.int32),
            }
            recorder.registers(tick, tick * 4_096_000, registers)
        for tick in (2, 3, 5):
            sent = np.arange(48).reshape(12, 4) % tick == 0
            recorder.messages(
                tick, tick * 4_096_000, {"sent": sent, "pose.at": np.full((12, 4, 2), tick / 3)}
            )
        traced = {"cell": np.array([2, 7]), "read.u": np.arange(8, dtype=np.uint64).reshape(2, 4) + 2**63}
        recorder.trace(6, 6 * 4_096_000, traced)
        recorder.control({"time_s": 0.03, "kind": "pause", "tick": 7})
        recorder.close("ok", "ab" * 32)
    return load(tmp_path / "run")


def same_bits(a: Any, b: Any) -> bool:
    first, second = np.ascontiguousarray(a), np.ascontiguousarray(b)
    return (first.dtype, first.shape, first.tobytes()) == (second.dtype, second.shape, second.tobytes())


def test_a_netcdf_file_gives_back_every_value_bit_for_bit(recording: Recording, tmp_path: Path) -> None:
    (path,) = export_recording(recording, "netcdf", tmp_path / "out.nc")
    with xr.open_dataset(path, engine="h5netcdf") as found:
        assert xr.Dataset.identical(found.load(), recording.to_xarray())
        for column, name in enumerate(("x", "y", "angle", "velocity_x", "velocity_y", "angular_velocity")):
            assert same_bits(found[name].values, recording.parcels[:, :, column])
        assert same_bits(found["presence"].values, recording.presence)
        assert same_bits(found["drives"].values, recording.drives)
        assert same_bits(found["wheel_speed"].values, recording.wheel_speeds)
        assert same_bits(found["tick"].values, recording.tick)
        assert same_bits(found["time_ns"].values, recording.time_ns)
        assert same_bits(found["time"].values, recording.time_s)
        assert same_bits(found["register firmware.u"].values, recording.registers["firmware.u"])
        assert same_bits(found["register n_a"].values, recording.registers["n/a"])
        assert same_bits(found["register_tick"].values, recording.register_tick)
        assert found["register n_a"].attrs["long_name"] == "n/a"
        assert same_bits(found["message_tick"].values, np.array([2, 3, 5]))
        assert found["message pose.at"].dims[:3] == ("message_time", "cell", "side")
        for name in ("sent", "pose.at"):
            assert same_bits(found[f"message {name}"].values, recording.messages[name])
        assert found["trace cell"].values.tolist() == [[2, 7]]
        assert found["trace read.u"].sel(side="west").values.tolist() == [[2**63 + 3, 2**63 + 7]]
        assert [json.loads(text) for text in found["events"].values] == EVENTS
        assert [json.loads(text) for text in found["faults"].values] == FAULTS
        assert json.loads(found["header"].item()) == recording.header
        assert found.attrs["digest"] == "ab" * 32
        assert found["present"].values[:, 0].tolist() == [True] * 8 + [False] * 5
        assert found["present"].values[:, 1].tolist() == [False] * 3 + [True] * 10


def test_every_number_of_the_dataset_has_a_name_and_units(recording: Recording) -> None:
    dataset = recording.to_xarray()
    assert all(variable.attrs["long_name"] for variable in dataset.variables.values())
    number = {
        name
        for name, variable in dataset.variables.items()
        if variable.dtype.kind == "f" and name.partition(" ")[0] not in ("register", "message", "trace")
    }
    assert all(dataset[name].attrs["units"] for name in number)
    assert dataset["drives"].attrs["units"] == "m s-1"
    assert dataset["x"].dims == ("time", "parcel")
    assert dataset.isel(cell=5).row.item() == 1
    assert dataset.isel(cell=5).column.item() == 1


def test_parquet_files_give_back_every_value_bit_for_bit(recording: Recording, tmp_path: Path) -> None:
    export_recording(recording, "parquet", tmp_path)
    found = pq.read_table(tmp_path / "parcels.parquet").to_pandas()
    for column, name in enumerate(PARCEL_NUMBERS):
        assert same_bits(found[name].to_numpy(), recording.parcels[:, :, column].ravel())
    assert same_bits(found["time_ns"].to_numpy(), np.repeat(recording.time_ns, 2))
    assert same_bits(found["tick"].to_numpy(), np.repeat(recording.tick, 2))
    assert found["parcel"].tolist() == [0, 1] * 13
    for name, records in (("events", EVENTS), ("faults", FAULTS)):
        rows = pq.read_table(tmp_path / f"{name}.parquet").to_pylist()
        assert [_restored(row) for row in rows] == [_without_none(record) for record in records]
    assert pq.read_table(tmp_path / "control.parquet").to_pylist() == [
        {"time_s": 0.03, "kind": "pause", "tick": 7}
    ]


def _restored(row: dict[str, Any]) -> dict[str, Any]:
    given = {name: value for name, value in row.items() if value not in (None, "")}
    lists = ("cells", "cell", "position_m")
    return {name: json.loads(value) if name in lists else value for name, value in given.items()}


def _without_none(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in record.items() if value is not None}


def test_csv_files_give_back_every_value_bit_for_bit(recording: Recording, tmp_path: Path) -> None:
    export_recording(recording, "csv", tmp_path)
    with (tmp_path / "parcels.csv").open(newline="", encoding="utf-8") as stream:
        found = list(csv.DictReader(stream))
    for column, name in enumerate(PARCEL_NUMBERS):
        assert same_bits([float(row[name]) for row in found], recording.parcels[:, :, column].ravel())
    assert same_bits([float(row["time_s"]) for row in found], np.repeat(recording.time_s, 2))
    assert [row["present"] for row in found[:4]] == ["True", "False"] * 2
    with (tmp_path / "faults.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["detail"] for row in rows] == ['a "quoted"\nline', ""]
    assert [row["number"] for row in rows] == ["", "3"]
    with (tmp_path / "events.csv").open(newline="", encoding="utf-8") as stream:
        events = list(csv.DictReader(stream))
    assert [float(row["time_s"]) for row in events] == [event["time_s"] for event in EVENTS]
    assert [json.loads(row["position_m"] or "null") for row in events] == [
        event["position_m"] for event in EVENTS
    ]


def test_tables_are_data_frames(recording: Recording) -> None:
    parcels = recording.to_pandas()
    assert len(parcels) == 26
    assert same_bits(parcels[parcels.parcel == 1]["y_m"].to_numpy(), recording.parcels[:, 1, 1])
    events = recording.to_pandas("events")
    assert events["kind"].tolist() == ["fed", "left", "overlap"]
    assert events["parcel"].dtype == "Int64"
    assert events["parcel"].isna().tolist() == [False, False, True]
    with pytest.raises(InputError, match="table 'wheels': must be one of parcels, events, faults, control"):
        recording.to_pandas("wheels")  # type: ignore[arg-type]


def test_foxglove_gets_its_own_messages_twenty_times_a_second(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(ticks=200, parcels=2, wheels_change=True, extra={"own_parcels": 1}, events=EVENTS[:2])
    recording = load(run.record(tmp_path))
    path, layout = export_recording(recording, "foxglove")
    assert [path.name, layout.name] == ["foxglove.mcap", "foxglove.layout.json"]
    found: dict[str, list[tuple[int, Any]]] = {}
    kinds = {}
    with path.open("rb") as stream:
        for schema, channel, message, content in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, content))
            kinds[channel.topic] = (schema.name, schema.encoding)
    assert kinds == {
        "/tf": ("foxglove.FrameTransforms", "protobuf"),
        "/cells": ("foxglove.Grid", "protobuf"),
        "/image": ("foxglove.RawImage", "protobuf"),
        "/parcels": ("foxglove.SceneUpdate", "protobuf"),
        "/events": ("foxglove.Log", "protobuf"),
    }
    times = [time for time, _ in found["/tf"]]
    duration_s = float(recording.time_s[-1])
    assert 10 < (len(times) - 1) / duration_s < 30
    assert times[-1] == recording.time_ns[-1]
    # bodies are sent once: parcel 0 from the start, parcel 1 when it is fed; parcel 0 is deleted when it leaves
    ids = [
        ([one.id for one in update.entities], [one.id for one in update.deletions])
        for _, update in found["/parcels"]
    ]
    assert ids == [(["parcel 0"], []), (["parcel 1"], ["parcel 0"])]
    body = found["/parcels"][0][1].entities[0].triangles[0]
    assert len(body.points) == 8
    assert len(body.indices) == 3 * (2 + 8)
    for time, message in found["/tf"]:
        row = int(np.searchsorted(recording.time_ns, time))
        for one in message.transforms:
            x, y, angle = recording.parcels[row, int(one.child_frame_id.split()[1]), :3]
            assert (one.translation.x, one.translation.y) == (x, y)
            assert 2 * math.atan2(one.rotation.z, one.rotation.w) == pytest.approx(angle)
    time, grid = found["/cells"][-1]
    cells = np.frombuffer(
        grid.data, [("rgba", "u1", 4), *((name, "<f4") for name in ("speed", "vx", "vy", "load"))]
    )
    assert grid.column_count == 4
    assert len(cells) == 12
    assert cells["vx"] == pytest.approx(recording.wheel_speeds[-1, :, 0], rel=1e-6)
    assert (grid.pose.position.x, grid.pose.position.y) == pytest.approx((-0.05, -0.05))
    assert set(json.loads(layout.read_text())["configById"]) == {"3D!array", "RosOut!events"}


def test_an_array_with_holes_has_transparent_places(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(rows=2, columns=2)
    header = run.header
    header["cells"] = [[0, 0], [0, 1], [1, 1], [2, 0]]
    header["positions_m"] = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.2]]
    with Recorder(tmp_path, header) as recorder:
        run.feed(recorder)
        recorder.close("ok")
    path, _ = export_recording(load(tmp_path), "foxglove")
    with path.open("rb") as stream:
        last = {
            channel.topic: content
            for _, channel, _, content in make_reader(
                stream, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages(topics=["/cells", "/image"])
        }
    grid, image = last["/cells"], last["/image"]
    alpha = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.cell_stride)[:, 3]
    assert alpha.tolist() == [255, 255, 0, 255, 255, 0]
    pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step // 3, 3)
    assert (image.width, image.height, image.encoding) == (42, 63, "rgb8")
    white = (pixels[10::21, 10::21] == 255).all(axis=-1)
    assert white.tolist() == [[False, True], [True, False], [False, False]]


@pytest.mark.parametrize("to", TIERED)
def test_a_recording_that_was_cut_and_one_without_instants_are_exported(
    tmp_path: Path, made_up_run: Make, to: str
) -> None:
    path = made_up_run().record(tmp_path)
    path.write_bytes(path.read_bytes()[:-300])
    assert all(one.stat().st_size for one in export_recording(load(path), to))
    Recorder(tmp_path / "none", made_up_run().header).close("failed")
    assert all(one.exists() for one in export_recording(load(tmp_path / "none"), to))


@pytest.mark.parametrize("to", TIERED)
def test_an_export_that_fails_leaves_what_was_there(
    recording: Recording, tmp_path: Path, to: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = export_recording(recording, to, tmp_path / "out")
    for path in written:
        path.write_text("before")

    def broken(path: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", broken)
    assert main(["export", str(recording.path), "--to", to, "--output", str(tmp_path / "out")]) == 1
    assert {path.read_text() for path in written} == {"before"}
    assert not list(tmp_path.rglob("*.draft"))


def test_an_export_replaces_an_earlier_one_and_never_the_recording(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.nc"
    out.write_text("before")
    assert main(["export", str(recording.path), "--to", "netcdf", "--output", str(out)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(out)]
    assert out.read_bytes().startswith(b"\x89HDF")
    before = recording.path.read_bytes()
    assert main(["export", str(recording.path), "--to", "foxglove", "--output", str(recording.path)]) == 2
    assert "is the recording itself" in capsys.readouterr().err
    assert recording.path.read_bytes() == before


@pytest.mark.parametrize(
    ("to", "module"),
    [
        *(("netcdf", name) for name in ("xarray", "h5netcdf", "h5py")),
        ("parquet", "pyarrow"),
        *(("foxglove", name) for name in ("foxglove_schemas_protobuf.Grid_pb2", "mcap_protobuf.schema")),
    ],
)
def test_a_library_that_is_not_installed_is_an_error_that_names_the_extra(
    recording: Recording,
    tmp_path: Path,
    to: str,
    module: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["export", str(recording.path), "--to", to, "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert f"needs {module.partition('.')[0]}, which comes with the extra export" in error
    assert "pip install 'mdms-emulator[export]'" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_next_run_in_a_folder_removes_every_file_that_exports_and_plots_write_there(
    recording: Recording, tmp_path: Path
) -> None:
    folder = tmp_path / "used"
    folder.mkdir()
    moved = folder / recording.path.name
    moved.write_bytes(recording.path.read_bytes())
    for form in EXPORTS:
        export_recording(load(moved), form)
    draw_kind(load(moved), "time", folder / "time.png")
    (folder / "csv" / "own.csv").write_text("kept")
    remove_results(folder)
    assert sorted(path.name for path in folder.rglob("*") if path.is_file()) == ["own.csv", "recording.mcap"]
    shutil.rmtree(folder / "csv")
    (folder / "csv").write_text("a file of that name")
    remove_results(folder)
