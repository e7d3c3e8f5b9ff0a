"""Build backend: hatchling's, but that a wheel is built where the package can run, to compile its kernels.

An editable installation needs no more than hatchling.
"""

from __future__ import annotations

import os
from typing import Any

from hatchling.build import *  # noqa: F403 - all hooks but one are hatchling's
from hatchling.build import get_requires_for_build_wheel as _hatchling_requires
from hatchling.builders.wheel import WheelBuilder


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return what building a wheel needs: what the package itself does, unless no kernels are asked for."""
    own = _hatchling_requires(config_settings)
    if os.environ.get("MDMS_WHEEL_SCENES") == "":
        return own
    return [*own, *WheelBuilder(".").metadata.core.dependencies]
