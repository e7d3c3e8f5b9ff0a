"""The chained digests of a run: of two runs with the same digest the same happened, bit for bit."""

from __future__ import annotations

import math
from hashlib import sha256
from math import isnan
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from deploy.errors import DeployError

PARCEL_FIELDS = ("x", "y", "angle", "vx", "vy", "omega")
"""Columns of a parcel's state."""


@final
class Digest:
    """SHA-256 over all that the cells sensed and commanded and how the parcels moved.

    ``d_0 = SHA256(description)`` and ``d_k = SHA256(d_(k-1) + tick bytes)``: the 32 bytes of ``value``
    are the whole state, so a checkpoint carries them. The bytes of a tick, little-endian: the tick as
    uint64; the presence bits in row-major cell order, a cell's sensors side by side, bit i of the row in
    bit i mod 8 of byte i div 8 and the last byte filled with zeros; the drives as float64; the parcel
    states as float64. Minus zero is written as zero. The motion digest is the same chain from
    ``m_0 = SHA256("")``: of two runs with the same one the same happened, whatever their scenes say.

    Args:
        description: Canonical bytes of what is run: scene, seed and versions of the formats, without
            anything that may differ between equal runs (partition, transport, paths, wall clock).
    """

    __slots__ = ("_drives", "_numbers", "_parcels", "motion", "value")
    state_fields: ClassVar[StateFields] = StateFields("value", "motion")

    def __init__(self, description: bytes) -> None:
        self.value: bytes = sha256(description).digest()
        """The chain so far, 32 bytes."""
        self.motion: bytes = sha256().digest()
        """The chain of the motion digest so far, 32 bytes."""
        self._resize((0, 2), (0, 6))

    def _resize(self, drives: tuple[int, ...], parcels: tuple[int, ...]) -> None:
        """Make room for the numbers of a tick, which is used again for those of the next."""
        count = math.prod(drives)
        self._numbers: NDArray[np.float64] = np.empty(count + math.prod(parcels), dtype="<f8")
        self._drives = self._numbers[:count].reshape(drives)
        self._parcels = self._numbers[count:].reshape(parcels)

    @property
    def hexdigest(self) -> str:
        """The chain so far, 64 hexadecimal digits."""
        return self.value.hex()

    @property
    def motion_hexdigest(self) -> str:
        """The motion digest so far, 64 hexadecimal digits."""
        return self.motion.hex()

    def tick(
        self,
        tick: int,
        presence: NDArray[np.bool_],
        drives: NDArray[np.float64],
        parcels: NDArray[np.float64],
    ) -> None:
        """Add one tick, once the plant has advanced through it.

        Args:
            tick: Which, from 0.
            presence: ``(n, sensors)`` bits sensed at the start of the tick.
            drives: ``(n, 2)`` that acted during the tick, a dead cell's as the stall policy has it.
            parcels: ``(m, 6)`` states at the end of the tick, so that the last state of a run is covered.

        Raises:
            DeployError: A NaN, which must have been found long before it came here.
        """
        if drives.shape != self._drives.shape or parcels.shape != self._parcels.shape:
            self._resize(drives.shape, parcels.shape)
        # Adding +0 turns minus zero into zero and nothing else.
        np.add(drives, 0.0, out=self._drives)
        np.add(parcels, 0.0, out=self._parcels)
        # A maximum is NaN if one number is: one cheap check a tick.
        if isnan(np.maximum.reduce(self._numbers, initial=-np.inf)):
            raise _found_nan(tick, drives, parcels)
        head = tick.to_bytes(8, "little") + np.packbits(presence, bitorder="little").tobytes()
        self.value = continued(self.value, head, self._numbers)
        self.motion = continued(self.motion, head, self._numbers)


def continued(chain: bytes, head: bytes, numbers: NDArray[np.float64]) -> bytes:
    """Return a chain after one more tick: its bytes are those of ``head``, then of ``numbers``."""
    link = sha256(chain + head)
    link.update(numbers.data)
    return link.digest()


def _found_nan(tick: int, drives: NDArray[np.float64], parcels: NDArray[np.float64]) -> DeployError:
    """Name the first NaN, drives before parcels."""
    if np.isnan(drives).any():
        cell, wheel = np.argwhere(np.isnan(drives))[0]
        where = f"drives[{cell}, {wheel}]"
    else:
        parcel, field = np.argwhere(np.isnan(parcels))[0]
        where = f"parcels[{parcel}].{PARCEL_FIELDS[field]}"
    return DeployError(f"this is a bug: tick {tick}: {where} is NaN when the digest is taken")
