"""Setting of a program's trials: a rectangle of cells with the readings that the program asks for."""

from __future__ import annotations

import numpy as np

from bus.lattice import Lattice
from cell_firmware.firmware import Cells, Firmware
from cell_firmware.specs import CellsSpec
from deploy.studies.firmware.trial import Setting

PITCH_M = 0.1


def setting_of(firmware: Firmware, spec: CellsSpec, lattice: Lattice, ticks: int, seed: int) -> Setting:
    """Return the setting of a program's trial.

    Args:
        firmware: The program, whose required effects decide which readings there are.
        spec: Control period and program.
        lattice: The cells.
        ticks: Number of ticks.
        seed: Seed of the trial.
    """
    position_m = PITCH_M * np.stack((lattice.columns, lattice.rows), axis=1)
    position_m -= position_m.mean(axis=0)
    cells = Cells.of(lattice, position_m, spec.period_s, pitch_m=PITCH_M)
    effects = firmware.required_effects()
    return Setting(
        cells,
        lattice,
        ticks,
        seed,
        motors="motors" in effects,
        level="analogue_sensors" in effects,
        label="scanners" in effects,
    )
