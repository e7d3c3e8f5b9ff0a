"""Parcels that come and go, in a run and in a simulation: sensed, recorded, counted and digested."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deploy.recordings.reader import load
from deploy.runs.field_simulation import simulate
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

SHORT = (
    "duration_s=2",
    "seed=3",
    "effects.feeders.feed.0.mean_s=0.1",
    "effects.feeders.feed.0.count=6",
    "effects.feeders.feed.0.velocity_m_s=[0.5,0]",
    "effects.feeders.exits.0.position_m=[-0.6,0.4]",
    "effects.feeders.exits.1.position_m=[-0.6,-0.4]",
)
"""The stream, its exits moved so near to its feeder that parcels leave within a second or so."""


def _scene(*changes: str) -> Scene:
    return load_scene("stream", [Override.parse(change) for change in (*SHORT, *changes)])


def _run(scene: Scene, output: Path) -> Summary:
    summary = run(scene, RunOptions(0, "memory", output=output, picture=False), quiet=True).summary
    assert summary.status == "ok"
    return summary


def test_a_run_and_a_simulation_feed_and_let_out_the_same_parcels_at_the_same_times(tmp_path: Path) -> None:
    ran, simulated = (
        _run(_scene(), tmp_path / "run"),
        simulate(_scene(), output=tmp_path / "simulation", picture=False, quiet=True).summary,
    )
    assert ran.feeders == simulated.feeders
    assert ran.feeders is not None
    assert (ran.feeders.waiting > 0, ran.feeders.left > 0) == (True, True)
    assert list(ran.parcels) == list(simulated.parcels)
    assert {parcel.state for parcel in ran.parcels} == {"waiting", "moving", "delivered"}


def test_the_recording_shows_who_is_there_and_the_cells_sense_nobody_else(tmp_path: Path) -> None:
    _run(_scene(), tmp_path)
    recording = load(tmp_path)
    track = recording.run_trace()
    assert [name for name, _ in track.exits] == ["north", "south"]
    states = track.parcels.copy()
    for event in recording.events:
        if event["kind"] == "left":  # at that very instant it is shown, but no longer sensed
            states[np.flatnonzero(track.time_s == event["time_s"]), event["parcel"]] = np.nan
    there = np.isfinite(states).all(axis=2).sum(axis=1)
    assert set(there.tolist()) == {0, 1, 2}
    x, y, angle = (states[:, None, :, column] for column in range(3))
    dx, dy = track.positions_m[:, 0, None] - x, track.positions_m[:, 1, None] - y
    along, across = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
    inside = (np.abs(along) < 0.17) & (np.abs(across) < 0.12)
    assert np.array_equal(recording.presence[:, :, 0], inside.any(axis=2))


def test_the_same_seed_gives_the_same_digest_and_another_seed_another_schedule(tmp_path: Path) -> None:
    one, again, other = (_run(_scene(*changes), tmp_path) for changes in ((), (), ("seed=4",)))
    assert one.digest == again.digest
    assert [parcel.time_s for parcel in one.parcels] != [parcel.time_s for parcel in other.parcels]


def test_the_digest_covers_where_parcels_wait(tmp_path: Path) -> None:
    late = ("effects.feeders.feed.0.first_s=5",)
    near, far = (
        _run(_scene("duration_s=0.02", *late, change), tmp_path)
        for change in ("title=''", "effects.feeders.feed.0.angle_spread_rad=0.5")
    )
    assert near.parcels[0].state == far.parcels[0].state == "waiting"
    assert near.digest != far.digest


def test_an_effect_that_is_absent_is_no_part_of_the_description() -> None:
    assert b"feeders" in _scene().canonical()
    assert b"feeders" not in load_scene("elliptic").canonical()
