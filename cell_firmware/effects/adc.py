"""Effect ``adc``: the converter through which a cell reads its analogue sensors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Final, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.random_streams import CounterStream
from cell_firmware.effects.base import CellEffectSpec, InputFilter, ShardContext, stream_ids
from cell_firmware.firmware import Inputs

CODES: Final = 256
"""Of the MC68HC11's converter, which has 8 bits."""
_SUMMED: Final = 4
"""Uniform numbers that make up one of the noise."""
_SPREAD: Final = (12.0 / _SUMMED) ** 0.5
"""What their sum has to be scaled by for a standard deviation of 1."""


@final
class AdcSpec(CellEffectSpec):
    """An 8-bit converter between analogue sensors and the cell.

    A cell reads a level in [0, 1] as ``code / 256``, where ``code = floor(256 level + noise)``, at least 0 and at most
    255.
    """

    needs: ClassVar[tuple[str, ...]] = ("analogue_sensors",)
    messages: ClassVar[tuple[str, ...]] = ("levels have 8 bits",)
    fidelity_rank: ClassVar[int | None] = 56
    noise_codes: Annotated[float, Field(ge=0, le=CODES, allow_inf_nan=False)] = 0.0
    """Root mean square, in codes, of the noise that is added to each reading before rounding."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Noise of half a code."""
        return cls(noise_codes=0.5)

    def input_filters(self, site: ShardContext) -> Iterator[InputFilter]:
        """One."""
        yield _Conversion(self.noise_codes, site)


@final
class _Conversion(InputFilter):
    """Noise is the sum of four uniform numbers: never beyond 3.5 times its root mean square, and no transcendentals."""

    def __init__(self, noise_codes: float, site: ShardContext) -> None:
        super().__init__()
        self._scale = _SPREAD * noise_codes
        each = stream_ids(site.sensor_stream_ids(), _SUMMED)
        self._draws = CounterStream(site.seed, "adc", each) if noise_codes else None

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Quantize levels to codes."""
        del alive
        assert inputs.level is not None, "this is a bug: no levels, but a converter"
        exact = CODES * inputs.level
        if self._draws is not None:
            one = self._draws.uniform(tick).reshape(*inputs.level.shape, _SUMMED)
            total = one[..., 0] + one[..., 1] + one[..., 2] + one[..., 3]
            exact = exact + self._scale * (total - 0.5 * _SUMMED)
        code = np.minimum(np.maximum(np.floor(exact), 0.0), CODES - 1.0)
        return replace(inputs, level=code / CODES)
