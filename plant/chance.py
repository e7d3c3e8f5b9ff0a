"""What is left to chance: a generator of random numbers for every purpose, from the scene's one seed."""

from __future__ import annotations

from hashlib import sha256

import numpy as np


def generator(seed: int, purpose: str) -> np.random.Generator:
    """The generator named after what it is for: its numbers don't depend on what else a scene draws.

    Args:
        seed: of the scene, >= 0.
        purpose: such as the name of an effect.
    """
    return np.random.default_rng([seed, *sha256(purpose.encode()).digest()])
