"""Every fault that a scene may schedule: a new one is a file and a line here."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from deploy.faults.crash import CrashFault
from plant.spec import tagged

AnyFault = CrashFault

Fault = Annotated[AnyFault, BeforeValidator(tagged("kind", "crash"))]
"""A scene's ``[[faults]]`` are told apart by ``kind``."""

KINDS: dict[str, type[AnyFault]] = {"crash": CrashFault}
