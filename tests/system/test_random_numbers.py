"""Random numbers of programs in whole runs: the same however the cells are cut, other ones for other seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.runs.run import run
from deploy.runs.setup import register_warnings
from deploy.runs.simulation import Simulation
from deploy.scenes.files import load_scene
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from tests.system.small import small_scene

GAMBLER = """
from mdms import CellFirmware, CellOutputs
import numpy as np

class Gambler(CellFirmware):
    message = np.dtype([("stake", "<f8")])
    random = ("turn", "stake")

    def init(self, cell):
        return cell.random["stake"]

    def step(self, bank, inputs):
        bank += sum(message["stake"] for message in inputs.inbox.values() if message is not None)
        stake = bank * inputs.random["stake"]
        if inputs.random["turn"] < 0.25:
            outbox = {side: {"stake": stake} for side in inputs.inbox}
            return bank - 4 * stake, CellOutputs((0.01 * bank, stake), outbox)
        return bank, CellOutputs((0.01 * bank, 0.0))
"""


def scene(folder: Path, seed: int = 3, duration_s: float = 0.1) -> Scene:
    (folder / "gambler.py").write_text(GAMBLER)
    text = small_scene(duration_s=duration_s).replace('"heat_diffusion"', '"gambler.py"')
    start, _, rest = text.partition("[cells.parameters]")
    (folder / "gamble.toml").write_text(
        f"seed = {seed}\n{start}\n[[parcels]]{rest.partition('[[parcels]]')[2]}"
    )
    return load_scene(str(folder / "gamble.toml"))


@pytest.mark.slow
def test_the_digest_depends_on_the_seed_and_on_nothing_of_how_a_run_is_cut(tmp_path: Path) -> None:
    ways: list[Any] = [
        (0, "memory", "packed"),
        (2, "zenoh", "per_cell"),
        (3, "zenoh", "packed"),
        ("each", "zenoh", "packed"),
    ]

    def digest(scene: Scene, way: Any) -> str | None:
        return run(scene, RunOptions(*way, output=tmp_path, picture=False), quiet=True).summary.digest

    digests = {digest(scene(tmp_path), way) for way in ways}
    assert len(digests) == 1
    assert digest(scene(tmp_path, seed=4), ways[0]) not in digests


def drives(scene: Scene) -> bytes:
    with Simulation.open(scene) as simulation:
        return b"".join(record.drives.tobytes() for record in iter(simulation.step, None))


def test_seeds_as_a_campaign_varies_them_vary_what_programs_do(tmp_path: Path) -> None:
    assert len({drives(scene(tmp_path, seed)) for seed in (1, 2, 3)}) == 3
    assert drives(scene(tmp_path, 1)) == drives(scene(tmp_path, 1))


def test_registers_that_can_not_be_recorded_are_found_by_an_init_that_draws(tmp_path: Path) -> None:
    gambler = scene(tmp_path)
    assert register_warnings(gambler) == ()
    (tmp_path / "gambler.py").write_text(GAMBLER.replace('cell.random["stake"]', 'str(cell.random["stake"])'))
    (warning,) = register_warnings(gambler)
    assert "its state is a str" in warning


def test_ticks_are_repeated_with_the_same_numbers_after_their_state_is_restored(tmp_path: Path) -> None:
    with Simulation.open(scene(tmp_path)) as simulation:
        for _ in range(5):
            simulation.step()
        saved = simulation.save_state()

        def following() -> list[bytes]:
            return [record.drives.tobytes() for _ in range(8) if (record := simulation.step()) is not None]

        first = following()
        simulation.load_state(saved)
        assert following() == first
