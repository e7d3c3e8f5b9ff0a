"""Arguments of kernels: arrays in one piece, and messages as bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def readable(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array in one piece, as kernels read it: the array itself if it is."""
    return array if array.flags.c_contiguous else np.ascontiguousarray(array)


def message_bytes(messages: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of messages in one piece, ``(..., size)``: the same memory."""
    return messages.view(np.uint8).reshape(*messages.shape, messages.dtype.itemsize)
