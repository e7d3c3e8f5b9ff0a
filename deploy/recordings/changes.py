"""Values of a recording that are written when they change, and that may not all fit into memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from deploy.recordings.mcap_reader import PackedChunk

_unpackb = cast("Callable[[bytes], dict[str, bytes]]", cast("Any", msgpack).unpackb)
_CHUNKS = 4
"""Chunks of a recording that are kept unpacked: values that are near in time are mostly in one, or in the next."""

Decode = Callable[[bytes], NDArray[Any]]
"""From the bytes of a value to the array."""


class Place(NamedTuple):
    """Place of a value in a recording: a key of a message.

    Attributes:
        chunk: Chunk that holds the message.
        start, stop: Bytes of the message in the chunk.
        key: Key of the value.
    """

    chunk: PackedChunk
    start: int
    stop: int
    key: str


@final
class PackedValues:
    """Values in compressed chunks, which take the memory that they take in the file.

    Args:
        places: Place of each value.
        decode: Decodes a value.
    """

    def __init__(self, places: Sequence[Place], decode: Decode) -> None:
        self._places, self._decode = places, decode
        self._unpacked = lru_cache(maxsize=_CHUNKS)(PackedChunk.unpack)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> NDArray[Any]:
        chunk, start, stop, key = self._places[number]
        return self._decode(_unpackb(self._unpacked(chunk)[start:stop])[key])


@final
@dataclass(frozen=True, eq=False)
class ChangeEncoded:
    """A field that is written only when it changes: the written values, and an index by instant.

    Attributes:
        values: Written values by number, of one shape: ``(changes, ...)``, or still compressed.
        index: Number of the value at each instant, ``(T,)`` int64.
    """

    values: NDArray[Any] | PackedValues
    index: NDArray[np.int64]

    def at(self, instant: int) -> NDArray[Any]:
        """Return the value at one instant."""
        return self.values[int(self.index[instant])]

    def all(self) -> NDArray[Any]:
        """Return the values at every instant, ``(T, ...)``."""
        if isinstance(self.values, PackedValues):
            return self._gathered(self.values, self.index, lambda value: value)
        return self.values[self.index]

    def of(self, row: int, instants: NDArray[np.int64] | slice = slice(None)) -> NDArray[Any]:
        """Return a row of the values, of a cell or a parcel, at some instants, ``(k, ...)``.

        Args:
            row: The row.
            instants: The instants; all unless given.
        """
        index = self.index[instants]
        if isinstance(self.values, PackedValues):
            return self._gathered(self.values, index, lambda value: value[row])
        return self.values[index, row]

    def each(self, instants: NDArray[np.int64]) -> Iterator[NDArray[Any]]:
        """Yield the different values at some instants."""
        for number in np.unique(self.index[instants]).tolist():
            yield self.values[number]

    def _gathered(
        self, values: PackedValues, index: NDArray[np.int64], part: Callable[[NDArray[Any]], NDArray[Any]]
    ) -> NDArray[Any]:
        """Return parts of the values by their numbers, each value unpacked once."""
        like = part(values[int(self.index[0])])
        found = np.empty((len(index), *like.shape), dtype=like.dtype)
        order = np.argsort(index, kind="stable")
        numbers, firsts = np.unique(index[order], return_index=True)
        for number, rows in zip(numbers.tolist(), np.split(order, firsts)[1:], strict=True):
            found[rows] = part(values[number])
        return found
