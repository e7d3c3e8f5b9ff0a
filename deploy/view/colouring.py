"""Colours of the cells: a quantity through a scale or categories, and its legend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.view.palette import STEPS, Theme, rgba, scale_of
from deploy.view.quantities import QUANTITIES, REGISTER, Quantity, quantity_of

if TYPE_CHECKING:
    from deploy.view.source import Instant, RunSource

_SAMPLES: Final = 24
"""Instants of a recording from which the limits of a scale are taken."""


@final
class Colouring:
    """Colours of all cells by one quantity; the limits of the scale grow, and never shrink while it is shown.

    Args:
        source: The run.
        extra: Quantities of this run beside the common ones.
        sampled: The same, evaluated at every instant for the limits; None: they are.

    Attributes:
        quantities: Quantities that can be chosen, registers left out.
        quantity: The chosen one.
    """

    def __init__(
        self, source: RunSource, extra: Sequence[Quantity] = (), sampled: Sequence[Quantity] | None = None
    ) -> None:
        self._source = source
        self.quantities = (*QUANTITIES, *extra)
        self._sampled = self.quantities if sampled is None else (*QUANTITIES, *sampled)
        self.quantity = self.quantities[0]
        self._limits: tuple[float, float] | None = None
        self._categories: Sequence[str] = ()

    def choose(self, name: str) -> None:
        """Choose a quantity by its identifier."""
        self.quantity = quantity_of(name, self.quantities)
        self._limits = None
        count, sampled = len(self._source.times_s), quantity_of(name, self._sampled)
        for index in np.unique(np.linspace(0, count - 1, min(count, _SAMPLES)).astype(np.int64)).tolist():
            values = sampled.values(self._source, index, self._source.at(index))
            if values.categories:
                return
            self._widen(values.numbers)

    def options(self) -> list[dict[str, str]]:
        """Return identifier and name of everything that can be chosen."""
        listed = [{"name": one.name, "label": one.label} for one in self.quantities]
        return listed + [{"name": REGISTER + name, "label": name} for name in self._source.register_names()]

    def colours(self, index: int, instant: Instant, theme: Theme) -> NDArray[np.uint32]:
        """Return the colour of every cell, ``(n,)``, and keep the legend for `legend`."""
        values = self.quantity.values(self._source, index, instant)
        self._categories = values.categories
        if values.categories:
            kinds = np.array([rgba(colour) for colour in theme.kinds], dtype=np.uint32)
            if self.quantity.name == "health":
                kinds = np.array(
                    [rgba(c) for c in (theme.kinds[0], theme.faulty, theme.dead)], dtype=np.uint32
                )
            number = np.maximum(values.numbers.astype(np.int64), 0)
            return kinds[np.where(number < len(kinds), number, 1 + (number - 1) % (len(kinds) - 1))]
        self._widen(values.numbers)
        low, high = self._limits or (0.0, 1.0)
        known = np.isfinite(values.numbers)
        share = np.zeros(len(values.numbers))
        np.divide(values.numbers - low, high - low, out=share, where=known & (high > low))
        step = np.clip(share * (STEPS - 1), 0, STEPS - 1).astype(np.int64)
        return np.where(known, scale_of(theme)[step], rgba(theme.line)).astype(np.uint32)

    def legend(self, theme: Theme) -> dict[str, Any]:
        """Return name, unit, and limits or categories with their colours."""
        low, high = self._limits or (0.0, 1.0)
        kinds = list(theme.kinds)
        if self.quantity.name == "health":
            kinds = [theme.kinds[0], theme.faulty, theme.dead]
        named = [
            {"name": name, "colour": kinds[k if k < len(kinds) else 1 + (k - 1) % (len(kinds) - 1)]}
            for k, name in enumerate(self._categories)
        ]
        return {
            "name": self.quantity.name,
            "label": self.quantity.label,
            "unit": self.quantity.unit,
            "low": low,
            "high": high,
            "categories": named,
            "scale": list(theme.scale),
        }

    def _widen(self, numbers: NDArray[np.float64]) -> None:
        known = numbers[np.isfinite(numbers)]
        if not len(known):
            return
        low, high = float(known.min()), float(known.max())
        if self._limits is None:
            self._limits = (min(low, 0.0), high)
        else:
            self._limits = (min(low, self._limits[0]), max(high, self._limits[1]))
