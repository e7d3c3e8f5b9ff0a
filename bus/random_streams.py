"""Named random streams, all derived from the scene's seed."""

from __future__ import annotations

from hashlib import sha256
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

_WORDS: Final = 4
"""Words that the generator makes from one value of its counter."""


def rng(seed: int, purpose: str) -> np.random.Generator:
    """Return the generator of a named stream, independent of all other streams of the scene.

    Args:
        seed: Seed of the scene, >= 0.
        purpose: Name of the stream, such as the name of an effect.
    """
    return np.random.default_rng(_entropy(seed, purpose))


def stream_key(seed: int, purpose: str) -> tuple[int, int]:
    """Return the key of a named stream for a counter-based generator: two words of 32 bits.

    Args:
        seed: Seed of the scene, >= 0.
        purpose: Name of the stream.
    """
    first, second = np.random.SeedSequence(_entropy(seed, purpose)).generate_state(2, np.uint32).tolist()
    return first, second


@final
class CounterStream:
    """Counter-based random stream: a number for each place and tick, a function of seed, purpose, tick and place.

    The numbers do not depend on the order, the frequency or the grouping of draws. The generator is Philox 4x64-10,
    keyed by seed and purpose: place p has word p mod 4 of the counter (p div 4 + 1, tick, 0, 0).

    Source: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.

    Args:
        seed: Seed of the scene, >= 0.
        purpose: Name of the stream, such as the name of an effect.
        places: ``(m,)`` int64, >= 0, at least one. All places from the least to the greatest are drawn.
    """

    def __init__(self, seed: int, purpose: str, places: NDArray[np.int64]) -> None:
        key = np.random.SeedSequence(_entropy(seed, purpose)).generate_state(2, np.uint64)
        first = int(places.min()) // _WORDS
        self._philox = np.random.Philox(key=key)
        # The generator steps its counter before it uses it. Setting its state takes a sixth of the time of a new one.
        self._state = self._philox.state
        self._counter = np.array([first, 0, 0, 0], dtype=np.uint64)
        self._state["state"]["counter"] = self._counter
        self._index = places - _WORDS * first
        self._count = int(self._index.max()) + 1

    def uniform(self, tick: int) -> NDArray[np.float64]:
        """``(m,)``, each in [0, 1), multiples of 2⁻⁵³."""
        self._counter[1] = tick
        self._philox.state = self._state
        words = self._philox.random_raw(self._count)[self._index]
        return (words >> np.uint64(11)).astype(np.float64) * 2.0**-53


def _entropy(seed: int, purpose: str) -> list[int]:
    return [seed, *sha256(purpose.encode()).digest()]
