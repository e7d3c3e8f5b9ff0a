"""Messages of a tile's cells, which make the tile act as a unit: words and pulses, of which the newest counts.

A *word* is a decision of a tile's leader. From bit 55 down: version (16 bits), freshness (8, remaining validity in
ticks), mode and side of the tile (8), exit of its parcel (8), ticket (16, version of the granted request). A *pulse*
is the leader's heartbeat: precedence (8), round (16), freshness (8). Both are repeated by all cells that have received
them, and lose one of their freshness in each tick and hop. So the newer of two counts, a lost message changes nothing,
and a word that is not refreshed expires after as many ticks as its freshness.

Versions and rounds are serial numbers of 16 bits (RFC 1982): after 65,535 comes 0, and of two the newer is the one that
is fewer than 32,768 steps ahead of the other. Words and pulses live for 255 ticks at most, and a leader that takes over
skips 16 versions, so all that are known at one time lie within a fraction of that.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Inbox

Ints = NDArray[np.int64]

OPPOSITES: Final = np.array([2, 3, 0, 1])
MASK_16: Final = 0xFFFF
MASK_8: Final = 0xFF
_HALF: Final = 1 << 15
_FRESH: Final = 1 << 32
_VERSION: Final = 40
"""Bits of a word below its version."""
_WORD_BITS: Final = 56
NEIGHBOURS: Final = ("north", "east", "south", "west")
TALK: Final = [
    ("pulse", "<u4"),
    ("alive", "<u2"),
    ("covered", "<u2"),
    ("label", "u1"),
    ("passed", "?"),
    ("own", "<i8"),
    *((side, "<i8") for side in NEIGHBOURS),
]
"""Fields of a message: leader's pulse, cells that have answered, cells under a parcel, reading of the label reader,
whether the leaving parcel has passed the cell, and words of the own tile and of the four neighbouring tiles."""


class TileMode(IntEnum):
    """Mode of a tile."""

    CLOSED = 0
    """Out of service: too few live cells, or not started yet."""
    FREE = 1
    EXPECT = 2
    """Reserved for the parcel of the tile on its side."""
    YIELD = 3
    """Was carrying a parcel over its side when its leader died: the tile there says who has it."""
    HOLD = 4
    """Has a parcel and knows no way for it."""
    WANT = 5
    """Has a parcel, and asks the tile on its side to take it."""
    PUSH = 6
    """Carries its parcel over its side."""


def word(version: Ints, fresh: int, doing: Ints, exit_: Ints, ticket: Ints) -> Ints:
    """Pack a word; ``doing`` is four times the mode plus the side."""
    return (version & MASK_16) << _VERSION | fresh << 32 | doing << 24 | exit_ << 16 | ticket & MASK_16


def version(words: Ints) -> Ints:
    """Return the version of each word."""
    return words >> _VERSION & MASK_16


def ahead_by(words: Ints, versions: int) -> Ints:
    """Return the words with the version increased by ``versions``."""
    below = (1 << _VERSION) - 1
    return (version(words) + versions & MASK_16) << _VERSION | words & below


def resumed(words: Ints, leaving: Bools, versions: int) -> Ints:
    """Return the words with which new leaders go on: the last words, with the version increased by ``versions``.

    A tile that was carrying its parcel over to another yields, with the version of its granted request as its ticket.

    Args:
        words: Last known words of the tiles.
        leaving: Whether the tile's parcel leaves the array: no other tile takes it.
        versions: Versions that are skipped.
    """
    mode, low = 63 << 26, MASK_16
    request = version(words) - 1 & MASK_16
    yields = (doing(words) == TileMode.PUSH) & ~leaving
    words = np.where(yields, words & ~(mode | low) | int(TileMode.YIELD) << 26 | request, words)
    return ahead_by(words, versions)


def is_word(words: Ints) -> Bools:
    """Whether nothing is set outside a word's bits."""
    return words >> _WORD_BITS == 0


def doing(words: Ints) -> Ints:
    """Return the mode of each tile; ``CLOSED`` where unknown."""
    return words >> 26 & 63


def side(words: Ints) -> Ints:
    """Return the side that the mode concerns."""
    return words >> 24 & 3


def exit_of(words: Ints) -> Ints:
    """Return the exit of the tile's parcel."""
    return words >> 16 & MASK_8


def ticket(words: Ints) -> Ints:
    """Return the version of the request that the tile grants."""
    return words & MASK_16


def older(words: Ints) -> Ints:
    """Age words by a tick or a hop; 0 where a word expires."""
    return np.where(words >> 32 & MASK_8 > 1, words - _FRESH, 0)


def older_pulse(pulses: Ints) -> Ints:
    """Age pulses by a tick or a hop; 0 where a pulse expires."""
    return np.where(pulses & MASK_8 > 1, pulses - 1, 0)


def _ahead(serials: Ints, known: Bools) -> Ints:
    """``(n, k)``: how far serial numbers lie ahead of the first known one of their row, plus 32,768; -1 if unknown."""
    first = np.take_along_axis(serials, known.argmax(axis=1)[:, None], axis=1)
    return np.where(known, serials - first + _HALF & MASK_16, -1)


def newest(words: Ints) -> Ints:
    """``(n,)``: the newest of ``(n, k)`` words of one tile, of the same version the freshest; 0 where none is known."""
    order = _ahead(version(words), words > 0) << _VERSION | words & (1 << _VERSION) - 1
    return np.maximum(np.take_along_axis(words, order.argmax(axis=1)[:, None], axis=1)[:, 0], 0)


def newest_words(own: Ints, around: Ints, inbox: Inbox, mate: Bools, used: Bools) -> tuple[Ints, Ints]:
    """Return the newest words received of a cell's own tile and of the four neighbouring tiles.

    Args:
        own: ``(n,)``, word of the own tile in the previous tick.
        around: ``(n, 4)``, words of the neighbouring tiles in the previous tick.
        inbox: Received messages.
        mate: ``(n, 4)``, whether the neighbour on the side is in the same tile.
        used: ``(n,)``, whether the cell is in a tile.

    Returns:
        New words of the own tile and of the neighbouring tiles.
    """
    message, n = inbox.message, len(own)
    known = np.empty((n, 5, 5), dtype=np.int64)  # by tile, its own last, and by sender, itself first
    known[:, :4, 0], known[:, 4, 0] = around, own
    for tile, name in enumerate((*NEIGHBOURS, "own")):
        known[:, tile, 1:] = np.where(mate, message[name], 0)
    beyond = np.where(mate | ~used[:, None], 0, message["own"])
    for number in range(4):  # either is 0
        known[:, number, 1 + number] += beyond[:, number]
    found = newest(older(known.reshape(5 * n, 5))).reshape(n, 5)
    return found[:, 4], found[:, :4]


def gathered(state: Any, inbox: Inbox) -> tuple[Ints, Ints, Ints, Ints]:
    """Return the newest pulse of a cell's own tile, and the answers gathered in its round.

    Returns:
        Pulse; bits of the cells that have answered, and of those with a parcel over them; the label that was read by
        any cell, of several that differ the greatest.
    """
    mate, message = state["mate"], inbox.message
    pulses = np.empty((len(mate), 5), dtype=np.int64)
    pulses[:, 0] = state["pulse"]
    pulses[:, 1:] = np.where(mate, message["pulse"], 0)
    pulses = older_pulse(pulses)
    precedence = pulses >> 24
    first = (precedence == precedence.max(axis=1)[:, None]) & (pulses > 0)
    ahead = _ahead(pulses >> 8 & MASK_16, first)
    same = first & (ahead == ahead.max(axis=1)[:, None])
    pulse = np.where(same, pulses, 0).max(axis=1)
    together: list[Ints] = []
    for name, joined in (("alive", np.bitwise_or), ("covered", np.bitwise_or), ("label", np.maximum)):
        of_all = np.empty((len(mate), 5), dtype=np.int64)
        of_all[:, 0], of_all[:, 1:] = state[name], message[name]
        together.append(joined.reduce(np.where(same, of_all, 0), axis=1))
    return pulse, together[0], together[1], together[2]
