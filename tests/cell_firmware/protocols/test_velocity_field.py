from collections.abc import Callable
from typing import Any

import numpy as np

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.firmware import Cells
from cell_firmware.protocols.velocity_field import VelocityField, VelocityFieldParameters


def test_every_cell_drives_the_fields_velocity_at_its_place_for_ever(
    grid: Callable[..., Lattice], everything: Callable[..., Cells], run: Callable[..., Any]
):
    parameters = VelocityFieldParameters.model_validate(
        {"field": {"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0}}
    )
    lattice = grid(4, 5, missing=[(2, 2)])
    position = everything(lattice).position_m
    want = parameters.field.velocity(position[:, 0], position[:, 1])
    drives = run(VelocityField(parameters), Partition.even(lattice, 3), 5).drives
    assert drives.tobytes() == np.tile(want, (5, 1, 1)).tobytes()
