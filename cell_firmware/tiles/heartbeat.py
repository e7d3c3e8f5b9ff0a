"""Heartbeat rounds of a tile: leadership, live cells, and presence of a parcel."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Inbox
from cell_firmware.tiles.messages import MASK_16, gathered

Ints = NDArray[np.int64]

_TURN_TICKS: Final = 8
"""Delay of each rank in taking over the lead: more than the propagation of a word through a tile."""
_ROUND_TICKS: Final = 24
"""Ticks after which a round ends without all answers."""
_SILENT_ROUNDS: Final = 2
"""Number of consecutive incomplete rounds after which a cell without an answer counts as dead."""


def initial_state(place: dict[str, NDArray[Any]], tile_cells: int) -> dict[str, NDArray[Any]]:
    """Return the initial state of rounds: no pulse, and all cells of the tile assumed live."""
    n, everyone = len(place["used"]), (1 << tile_cells * tile_cells) - 1
    return {
        **{name: np.zeros(n, dtype=np.int64) for name in ("pulse", "alive", "covered", "label")},
        **{name: np.zeros(n, dtype=np.int64) for name in ("recent", "missed", "since", "sure", "read")},
        "members": np.full(n, everyone),
        "occupied": np.zeros(n, dtype=np.bool_),
    }


def on_messages(
    state: Any, inbox: Inbox, here: Bools, label: Ints, ttl_periods: int
) -> tuple[dict[str, NDArray[Any]], Bools, Bools]:
    """Handle received pulses: find the newest, add the cell's own answer, and determine the leader.

    A cell leads whose pulse is the newest that it knows. Where the last has died out, ``ttl_periods`` ticks after it
    was sent, cells take over in the order of their rank. Where two lead, the one of lower rank has the greater pulse,
    and the other follows.

    Args:
        state: State of the firmware.
        inbox: Received messages.
        here: ``(n,)``, whether a parcel is over the cell.
        label: ``(n,)``, reading of the label reader; 0 for none.
        ttl_periods: Validity of a pulse, ticks.

    Returns:
        The next state, which cells lead, and which have just taken over.
    """
    pulse, alive, covered, read = gathered(state, inbox)
    silence = np.where(pulse == 0, state["silence"] + 1, 0)
    mine = 255 - state["rank"]
    takes_over = state["used"] & (silence > _TURN_TICKS * state["rank"])
    leads = state["used"] & (takes_over | (pulse >> 24 == mine))
    number = np.where(takes_over, state["pulse"] >> 8 & MASK_16, pulse >> 8 & MASK_16)
    pulse = np.where(leads, mine << 24 | number << 8 | ttl_periods, pulse)
    after = {
        "pulse": pulse,
        "silence": np.where(takes_over, 0, silence),
        "alive": np.where(pulse > 0, alive | state["bit"], 0),
        "covered": np.where(pulse > 0, covered | np.where(here, state["bit"], 0), 0),
        "label": np.where(pulse > 0, np.maximum(read, label), 0),
    }
    return after, leads, takes_over


def round_finished(state: Any, after: dict[str, NDArray[Any]], leads: Bools) -> Bools:
    """Advance a leader's rounds by a tick, and add the results to ``after``.

    A round in which all live cells answer shows whether a parcel is over any of them. A round that takes too long has
    no result; after several of these in a row, a cell that answered in none counts as dead. A cell that answers lives.

    Returns:
        ``(n,)``, whether a round has ended, complete or timed out.
    """
    since = state["since"] + 1
    full = leads & (after["alive"] & state["members"] == state["members"])
    late = leads & ~full & (since >= _ROUND_TICKS)
    missed = np.where(late, state["missed"] + 1, np.where(full, 0, state["missed"]))
    recent = np.where(late, state["recent"] | after["alive"], np.where(full, 0, state["recent"]))
    fewer = missed >= _SILENT_ROUNDS
    members = np.where(fewer, recent, state["members"]) | np.where(full, after["alive"], 0)
    after["members"] = members
    after["missed"] = np.where(fewer, 0, missed)
    after["recent"] = np.where(fewer, 0, recent)
    after["occupied"] = np.where(full, after["covered"] != 0, state["occupied"])
    after["read"] = np.where(full & (after["covered"] != 0), after["label"], np.where(full, 0, state["read"]))
    after["sure"] = np.where(full, state["sure"] + 1, state["sure"])
    after["since"] = np.where(leads, since, 0)
    return full | late


def start_round(state: Any, after: dict[str, NDArray[Any]], where: Bools, here: Bools, label: Ints) -> None:
    """Begin a new round where requested."""
    pulse = after["pulse"]
    number = (pulse >> 8) + 1 & MASK_16
    after["pulse"] = np.where(where, pulse >> 24 << 24 | number << 8 | pulse & 255, pulse)
    after["alive"] = np.where(where, state["bit"], after["alive"])
    after["covered"] = np.where(where, np.where(here, state["bit"], 0), after["covered"])
    after["label"] = np.where(where, label, after["label"])
    after["since"] = np.where(where, 0, after["since"])
