from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells, Inbox, Inputs
from cell_firmware.protocols.wave import Wave, WaveParameters

BUMP: dict[str, Any] = {
    "courant_number_squared": 0.4,
    "initial": [{"cell": [2, 3], "speed_m_s": [1.0, -0.5]}, {"rows": [4, 4], "speed_m_s": [-0.3, 0.7]}],
    "held": [{"columns": [0, 0], "speed_m_s": [0.4, 0.1]}],
}


def wave(**changes: Any) -> Wave:
    return Wave(WaveParameters.model_validate({**BUMP, **changes}))


def laplacian(lattice: Lattice) -> NDArray[np.float64]:
    matrix = np.zeros((len(lattice), len(lattice)))
    for i, side in zip(*np.nonzero(lattice.neighbours >= 0), strict=True):
        matrix[i, i] += 1.0
        matrix[i, lattice.neighbours[i, side]] -= 1.0
    return matrix


def test_every_tick_is_the_sum_of_modes_that_swing_at_their_own_frequencies(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    """A mode that begins at rest is ``cos((k + 1/2) t) / cos(t / 2)``, with ``sin(t/2)^2 = c2 lambda / 4``."""
    lattice, firmware = grid(5, 6, missing=[(1, 1), (3, 4)]), wave()
    seen = watch(firmware, lattice, 400)
    start, held = firmware.parameters.start(lattice.rows, lattice.columns)
    rest = firmware.parameters.laplacian(lattice).steady_state(start)
    values, modes = np.linalg.eigh(laplacian(lattice)[~held][:, ~held])
    angle = 2.0 * np.arcsin(np.sqrt(0.4 * values / 4.0))
    amount = modes.T @ (start - rest)[~held]
    for k in range(400):
        swing = np.cos((k + 0.5) * angle) / np.cos(0.5 * angle)
        np.testing.assert_allclose(seen[k, held], start[held], rtol=0, atol=0)
        want = rest[~held] + modes @ (swing[:, None] * amount)
        np.testing.assert_allclose(seen[k, ~held], want, rtol=0, atol=1e-11, err_msg=f"tick {k}")


@pytest.mark.slow
def test_energy_is_conserved_over_a_hundred_thousand_ticks() -> None:
    """The firmware's own step, its messages handed over by a plain loop over sides."""
    lattice = Lattice((r, c) for r in range(3) for c in range(4) if (r, c) != (1, 1))
    near, inside = lattice.neighbours, lattice.neighbours >= 0
    firmware = wave(initial=[{"cell": [2, 3], "speed_m_s": [1.0, -0.5]}])
    state = firmware.init(Cells.of(lattice, np.zeros((len(lattice), 2)), 0.004))
    inbox = Inbox(np.zeros((11, 4), dtype=np.bool_), np.zeros((11, 4), dtype=firmware.message))
    matrix, nothing = laplacian(lattice), np.zeros((11, 1), dtype=np.bool_)

    def energy(after: NDArray[np.float64], before: NDArray[np.float64], change: NDArray[np.float64]) -> float:
        return 0.5 * float((change**2).sum() + 0.4 * (after * (matrix @ before)).sum())

    energies: list[float] = []
    for tick in range(100_000):
        before = state["speed_m_s"]
        state, outputs = firmware.step(state, Inputs(nothing, None, inbox))
        assert outputs.outbox is not None
        message = np.where(inside, outputs.outbox.message[near, OPPOSITE], np.zeros((), firmware.message))
        inbox = Inbox(inside, message)
        if tick % 1000 == 1:
            energies.append(energy(state["speed_m_s"], before, state["change_m_s"]))
    assert energies[0] > 0.1
    np.testing.assert_allclose(energies, energies[0], rtol=1e-10)


@pytest.mark.parametrize(("damping", "factor"), [(0.1, np.sqrt(0.9 / 1.1)), (0.6, None)])
def test_with_damping_waves_die_down_at_the_predicted_factor_to_what_heat_comes_to(
    damping: float, factor: float | None, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(5, 6), wave(damping=damping)
    theory = firmware.theory(lattice)
    if factor is not None:
        assert theory.factor == pytest.approx(factor, rel=1e-12)
    error = abs(watch(firmware, lattice, 280) - theory.limit).max(axis=(1, 2))
    crests = error.reshape(-1, 40).max(axis=1)
    assert (crests[5] / crests[2]) ** (1 / 120) == pytest.approx(theory.factor, rel=3e-3)


def test_above_the_limit_waves_grow_as_the_warning_says(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, firmware = grid(5, 6), wave(courant_number_squared=0.55)
    (warning,) = firmware.warnings(lattice)
    drives = run(firmware, Partition.even(lattice, 1), 300).drives
    growth = np.linalg.norm(drives[-1]) / np.linalg.norm(drives[-2])
    assert growth == pytest.approx(firmware.theory(lattice).factor, rel=1e-9)
    assert growth > 1.1
    assert f"grow by a factor of {growth:.6g} a tick, without bound" in warning
    bears = wave(courant_number_squared=0.505)
    greatest = (
        3.0 + 2.0 - 2.0 * np.cos(3 * np.pi / 5)
    )  # of three free cells in a row, and of two with a held one
    (warning,) = bears.warnings(grid(3, 3))
    assert warning.endswith(f"the bound on four neighbours; this array bears {4.0 / greatest:.6g}")
    assert abs(run(bears, Partition.even(grid(3, 3), 1), 2000).drives).max() < 10.0
    assert wave(courant_number_squared=0.5).warnings(lattice) == ()


def test_waves_come_back_from_free_ends_upright_and_from_fixed_ones_upside_down(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    """On a row half of a pulse runs west, soon meets the end, and follows the other half as 1/2 or as -1/2."""
    row = grid(1, 60)

    def total(held: list[dict[str, Any]]) -> float:
        pulse = [{"cell": [0, 6], "speed_m_s": [1.0, 0.0]}]
        firmware = wave(courant_number_squared=0.25, initial=pulse, held=held)
        return float(watch(firmware, row, 60)[40:, :, 0].sum(axis=1).mean())

    assert total([]) == pytest.approx(1.0, abs=1e-12)
    assert total([{"cell": [0, 0], "speed_m_s": [0.0, 0.0]}]) == pytest.approx(0.0, abs=0.05)


def test_waves_are_the_same_to_the_last_bit_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, firmware = grid(5, 6, missing=[(1, 1), (3, 4)]), wave(damping=0.01)
    whole = run(firmware, Partition.even(lattice, 1), 60, dead={20: [(3, 3)]}).drives
    for shards in (3, 28):
        cut = run(firmware, Partition.even(lattice, shards), 60, dead={20: [(3, 3)]}).drives
        assert cut.tobytes() == whole.tobytes()


def test_on_bad_links_it_takes_damping_to_keep_a_wave_from_growing(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(5, 6)
    late = CellEffects.model_validate({"link_delay": {"between_ticks": [0, 4]}})
    lossy = CellEffects.model_validate({"link_loss": {"probability": 0.2}})
    assert abs(watch(wave(), lattice, 600, effects=lossy)[-1]).max() > 10.0
    assert abs(watch(wave(damping=0.2, ttl_periods=20), lattice, 600, effects=late)[-1]).max() > 10.0
    ends = [*BUMP["held"], {"columns": [5, 5], "speed_m_s": [0.0, 0.0]}]
    damped = wave(damping=0.6, ttl_periods=20, held=ends, initial=BUMP["initial"][:1])
    for effects in (late, lossy):
        end = watch(damped, lattice, 800, effects=effects)[-1]
        np.testing.assert_allclose(end, damped.theory(lattice).limit, rtol=0, atol=1e-6)
