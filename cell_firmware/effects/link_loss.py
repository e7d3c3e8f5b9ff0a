"""Effect ``link_loss``: messages between neighbours that never arrive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.random_streams import CounterStream
from cell_firmware.effects.base import CellEffectSpec, InputFilter, ShardContext
from cell_firmware.firmware import Inbox, Inputs


@final
class LinkLossSpec(CellEffectSpec):
    """Messages between neighbours are lost independently, with the same probability."""

    messages: ClassVar[tuple[str, ...]] = ("messages between neighbours get lost",)
    fidelity_rank: ClassVar[int | None] = 80
    probability: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
    """Probability, for each message, that it is lost."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """One message in a hundred."""
        return cls(probability=0.01)

    def input_filters(self, site: ShardContext) -> Iterator[InputFilter]:
        """One, where there are messages to lose."""
        if self.probability and site.message is not None:
            yield _Loss(self.probability, site, site.message)


@final
class _Loss(InputFilter):
    def __init__(self, probability: float, site: ShardContext, message: np.dtype[np.void]) -> None:
        super().__init__()
        self._probability = probability
        self._nothing = np.zeros((), dtype=message)
        self._draws = CounterStream(site.seed, "link_loss", site.link_stream_ids())
        self.counters["lost"] = 0

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Remove lost messages from the inbox."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: no inbox, but messages to lose"
        chance = self._draws.uniform(tick).reshape(inbox.received.shape)
        lost = inbox.received & (chance < self._probability)
        self.count("lost", lost, alive)
        inbox.message[lost] = self._nothing
        return replace(inputs, inbox=Inbox(inbox.received & ~lost, inbox.message))
