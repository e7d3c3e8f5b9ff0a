"""Every field there is: a new one is a file and a line here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field as Tagged

from cell_firmware.fields.elliptic import Elliptic
from cell_firmware.fields.expression import Expression
from cell_firmware.fields.radial import Radial
from cell_firmware.fields.squeeze import Squeeze
from cell_firmware.fields.sum import Sum
from cell_firmware.fields.uniform import Uniform
from cell_firmware.fields.vortex import Vortex

FieldSpec = Annotated[
    Elliptic  # linear, the paper's Fig. 12
    | Expression  # any formula of x and y
    | Radial  # away from a centre, or towards it
    | Squeeze  # two halves towards a line, the paper's Fig. 14
    | Sum  # several at once
    | Uniform  # the same everywhere
    | Vortex,  # round a centre
    Tagged(discriminator="kind"),
]
"""Any field, discriminated by its ``kind``."""

Sum.model_rebuild(_types_namespace={"FieldSpec": FieldSpec})
