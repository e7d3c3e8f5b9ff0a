"""What a shard takes in in a tick: what its cells sense, and what their neighbours in other shards tell them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, final

from bus.collector import Collector, Slot
from bus.counts import Counts
from bus.dispatch import Route
from bus.forms.form import MemberForm, Wiring
from bus.lives import Lives
from bus.transport import Endpoint
from bus.wire import LinkFrame, SenseFrame


class Gathered(NamedTuple):
    """What a shard computes a tick from.

    Attributes:
        sense: Of this tick; rows in the order of ``partition.cells(shard)``, false and zero for cells that
            are gone.
        links: What the links of ``partition.incoming(shard)`` brought, sent in the tick before: ``tick - 1``.
            At tick 0 nothing was sent. None where the firmware has no messages.
    """

    sense: SenseFrame
    links: LinkFrame | None


@final
class Incoming:
    """Collects the payloads of a shard's frames, and waits for those of the living.

    Args:
        wiring: What both sides agreed on.
        shard: Which shard this is.
        form: Its side of the wire form.
        lives: Who takes part, kept by the caller, who tells of changes by ``bury`` and ``admit``.
        counts: Where to count.
    """

    def __init__(self, wiring: Wiring, shard: int, form: MemberForm, lives: Lives, counts: Counts) -> None:
        self._form = form
        self._lives = lives
        self._counts = counts
        self._cells = wiring.partition.cells(shard)
        self._speaks = wiring.message is not None
        self._first = 0
        self._senses = Collector("sense", form.blank_senses, form.decode_sense, counts)
        self._links = Collector("link", form.blank_links, form.decode_link, counts)

    def subscribe(self, endpoint: Endpoint) -> dict[str, Route]:
        """Subscribes to all of it: what takes the payloads of each key."""
        for key in self._form.sense_units:
            endpoint.subscribe(key)
        # The plant senses again only when all drives have come, and messages are put before drives: they are there
        # when the senses are.
        for key in self._form.in_parts:
            endpoint.subscribe(key, "quiet")
        return {
            **{key: (self._senses.take, unit) for key, unit in self._form.sense_units.items()},
            **{key: (self._links.take, part) for key, part in self._form.in_parts.items()},
        }

    # --- a tick ---------------------------------------------------------------------------------

    def slots(self, tick: int) -> tuple[Slot, Slot | None]:
        """The tick's senses and the messages of the tick before, as far as they have come; None: there are none."""
        # At its first tick nobody has sent it anything.
        links = None if not self._speaks or tick == self._first else self._links.slot(tick - 1)
        return self._senses.slot(tick), links

    def taken_in(self, tick: int) -> int:
        """How many payloads have been taken in, but for messages that were sent in ``tick`` or later."""
        return self._counts.delivered - (self._links.early(tick) if self._speaks else 0)

    def hand_over(self, tick: int) -> Gathered:
        """All of a tick, of which nothing more is waited for."""
        senses = self._form.join_senses(self._senses.close(tick).values)
        if not self._lives.all:
            gone = ~self._lives.live(tick)[self._cells]
            for sensed in (senses.presence, senses.encoder_m, senses.level, senses.label):
                if sensed is not None:
                    sensed[gone] = 0
        sense = SenseFrame(tick, *senses)
        if not self._speaks:
            return Gathered(sense, None)
        values = self._form.blank_links if tick == self._first else self._links.close(tick - 1).values
        return Gathered(sense, LinkFrame(tick - 1, *self._form.join_links(values)))

    # --- from when on, and of whom --------------------------------------------------------------

    def await_first(self) -> None:
        """Keeps whatever tick comes until it is said which is the first."""
        self._senses.await_first()
        self._links.await_first()

    def resume(self, tick: int) -> None:
        """``tick`` is the next; its neighbours' messages of the one before will come again."""
        self._senses.begin(tick)
        self._links.begin(tick - 1)

    def enter(self, tick: int) -> None:
        """``tick`` is the first that the shard takes part in: nobody has sent it anything."""
        self._first = tick
        self.resume(tick)

    def bury(self) -> None:
        """Takes note of who is gone."""
        last, form = self._lives.last, self._form
        self._senses.bury(last(form.unit_cells))
        # What is sent in tick k is read in k + 1: nobody sends to a cell that will not read.
        sources, targets = last(form.in_sources), last(form.in_targets)
        self._links.bury([min(source, target - 1) for source, target in zip(sources, targets, strict=True)])

    @property
    def awaited(self) -> int:
        """How many messages have not come of the tick that is not over yet."""
        return len(self._links.missing(self._links.now))

    def void(self, tick: int) -> None:
        """Those who are gone by ``tick``, in which they were lost, said nothing in it; after ``bury``."""
        # What they sent before has arrived, or will; of that tick it may have, or not: it never was.
        gone = [part for part, until in enumerate(self._links.until) if until <= tick]
        self._links.void(gone, tick)

    def expect(self, cells: Iterable[int]) -> None:
        """Cells (indices) that are gone may come back: their word may come before the news of it."""
        back = set(cells)
        sources = enumerate(self._form.in_sources)
        self._links.expect(part for part, source in sources if not back.isdisjoint(source.tolist()))

    def admit(self) -> None:
        """Takes note of who takes part again."""
        first, last, form = self._lives.first, self._lives.last, self._form
        self._senses.admit(first(form.unit_cells), last(form.unit_cells))
        sources, targets = form.in_sources, form.in_targets
        since = [max(pair) for pair in zip(first(sources), first(targets), strict=True)]
        until = [min(s, t - 1) for s, t in zip(last(sources), last(targets), strict=True)]
        self._links.admit(since, until)
