"""Modules are pulled out while it runs."""

from __future__ import annotations

from typing import ClassVar, Literal, final

from deploy.faults.module import AbsentModules


@final
class RemoveFault(AbsentModules):
    """Cells that are pulled out of the array at ``at_s``, and plugged in again where ``until_s`` says so."""

    called: ClassVar[str] = "remove"
    kind: Literal["remove"]
