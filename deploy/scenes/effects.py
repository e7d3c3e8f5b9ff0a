"""All effects of a scene: the plant's and the cells'."""

from __future__ import annotations

from cell_firmware.effects.registry import CellEffects
from plant.effects.registry import PlantEffects


class EffectsSpec(PlantEffects, CellEffects):
    """Effects the scene asks for; an absent one is not simulated and costs nothing."""

    def of_plant(self) -> PlantEffects:
        """Select the effects that the plant implements."""
        return PlantEffects(**{name: getattr(self, name) for name in PlantEffects.model_fields})

    def of_cells(self) -> CellEffects:
        """Select the effects that the cells implement."""
        return CellEffects(**{name: getattr(self, name) for name in CellEffects.model_fields})
