"""Libraries of the optional extra ``export``."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from deploy.errors import InputError


def library(module: str, purpose: str) -> Any:
    """Import a library of the extra ``export``.

    Args:
        module: Name of the module.
        purpose: What needs it, as the subject of a sentence.

    Raises:
        InputError: It is not installed; the message names the extra.
    """
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise InputError(
            f"{purpose} needs {name}, which comes with the extra export: pip install 'mdms-emulator[export]'"
        ) from None
