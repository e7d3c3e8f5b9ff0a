"""Modules are plugged in while it runs, where there were none."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Literal, Self, final

from pydantic import model_validator

from deploy.faults.module import AbsentModules


@final
class AddFault(AbsentModules):
    """Cells that are not there at the start, and are from ``at_s`` on."""

    called: ClassVar[str] = "add"
    kind: Literal["add"]

    @model_validator(mode="after")
    def _comes_once(self) -> Self:
        if self.at_s == 0.0:
            raise ValueError("at_s must be > 0: what is added at the start is there")
        if self.until_s is not None:
            raise ValueError("what is added stays: leave until_s out, and pull it by a fault of kind remove")
        return self

    def span(self, tick_at: Callable[[float], int]) -> tuple[int, int]:
        """It acts until its cells are there."""
        return 0, tick_at(self.at_s)
