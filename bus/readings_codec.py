"""Labels that scanners read and pictures that cameras take, as payloads have them: bounded, typed."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

from bus.codec import NUMBERS, Values, all_finite, binary
from bus.errors import WireError
from bus.readings import Labels, Picture

PICTURED_BYTES: Final = 40
"""The most bytes that a parcel takes in a picture."""
_PICTURED: Final = 4
"""Numbers that a picture has of a parcel."""
_U2: Final = np.dtype("<u2")


def label_bytes(label: Labels) -> bytes:
    """Labels, two bytes each."""
    return label.astype(_U2).tobytes()


def labels(kind: str, value: object, rows: int, largest: int) -> Labels:
    """``(rows,)`` labels from the bytes that ``label_bytes`` made, which may be written.

    Raises:
        WireError: Another length, or a label above the largest.
    """
    found = np.frombuffer(binary(kind, value, 2 * rows), _U2).astype(np.int64)
    if (found > largest).any():
        raise WireError(kind, "range", f"label must be in 0..{largest}")
    return found


def label(kind: str, value: object, largest: int) -> int:
    """A label.

    Raises:
        WireError: Something else.
    """
    if type(value) is not int:
        raise WireError(kind, "type", "label must be an integer")
    if not 0 <= value <= largest:
        raise WireError(kind, "range", f"label must be in 0..{largest}")
    return value


def picture_rows(shown: Picture | None) -> list[list[float]] | None:
    """A picture as rows of parcel, x, y and angle; nil for none."""
    if shown is None:
        return None
    return [[parcel, *pose] for parcel, pose in zip(shown.parcel.tolist(), shown.pose.tolist(), strict=True)]


def picture(kind: str, value: object, most: int) -> Picture | None:
    """What a camera saw from what ``picture_rows`` made: of parcels 0 to ``most`` - 1, each once, in their order.

    Raises:
        WireError: Something else.
    """
    if value is None:
        return None
    if type(value) is not list or len(cast("list[object]", value)) > most:
        raise WireError(kind, "type", f"picture must be nil or a list of at most {most} parcels")
    parcels, poses, last = list[int](), list[list[float]](), -1
    for row in cast("list[Any]", value):
        if type(row) is not list or len(cast("list[Any]", row)) != _PICTURED:
            raise WireError(kind, "type", "a parcel in a picture must be its number, x, y and angle")
        parcel, *pose = cast("list[Any]", row)
        if type(parcel) is not int or not NUMBERS.issuperset(map(type, pose)):
            raise WireError(kind, "type", "a parcel in a picture must be its number, x, y and angle")
        if not last < parcel < most:
            raise WireError(kind, "range", f"parcels in a picture must ascend in 0..{most - 1}")
        parcels.append(parcel)
        poses.append([float(number) for number in pose])
        last = parcel
    found: Values = np.array(poses, dtype=np.float64).reshape(-1, 3)
    if not all_finite(found):
        raise WireError(kind, "finite", "every value must be finite")
    return Picture(np.array(parcels, dtype=np.int64), found)
