"""Facts of a process that determine the bits of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bus.kernel_cache.processor import level
from deploy.checkpoints.store import fingerprint

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene


def bit_facts(scene: Scene) -> dict[str, str]:
    """Return everything that determines the bits of a run in this process, by name."""
    name, features = level()
    return {**fingerprint(scene), "the processor level": f"{name} {features}".strip()}
