"""Controllers around another: what they remember is a part of the state that the other knows nothing of."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cell_firmware.controller import Controller, ControllerState, frozen
from cell_firmware.firmware import State


class Around(Controller):
    """Base of what decides when the cells' controller is stepped, and what becomes of what it does.

    Args:
        controller: The cells' own.
    """

    part: ClassVar[str]
    """Its part of the state, and the first word of its registers."""
    shown: ClassVar[tuple[str, ...]]
    """Arrays of that part that are registers."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    @property
    def message(self) -> np.dtype[Any] | None:
        """What a link carries in a tick."""
        return self.controller.message

    @property
    def said(self) -> np.dtype[Any] | None:
        """What programs say."""
        return self.controller.said

    @property
    def tentative(self) -> bool:
        """As the cells' controller has it."""
        return self.controller.tentative

    def inner(self, state: ControllerState) -> ControllerState:
        """What the cells' controller knows of."""
        parts = {name: part for name, part in state.parts.items() if name != self.part}
        return ControllerState(state.cells, parts)

    def outer(self, inner: ControllerState, own: State) -> ControllerState:
        """The state of both, of the same cells."""
        return ControllerState(inner.cells, {**inner.parts, self.part: frozen(own)})

    def registers(self, state: ControllerState) -> dict[str, NDArray[Any]]:
        """Its own, and those of the cells' controller."""
        own = state.parts[self.part]
        shown = {f"{self.part}.{name}": own[name] for name in self.shown}
        return {**shown, **self.controller.registers(self.inner(state))}

    def counted(self, state: ControllerState) -> dict[str, int]:
        """What the cells' controller has counted."""
        return self.controller.counted(self.inner(state))
