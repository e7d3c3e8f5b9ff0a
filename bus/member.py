"""The cells' side of the lockstep: one shard."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from bus import wire
from bus.collector import Collector
from bus.counts import Counts
from bus.dispatch import Dispatcher
from bus.errors import BarrierError, HostLostError, WireError
from bus.forms import FORMS, FormName
from bus.forms.form import MemberForm, Wiring
from bus.keeping import Kept, encode_kept
from bus.keys import plant_key, shard_key
from bus.lives import Lives
from bus.outgoing import Outgoing
from bus.partition import Partition
from bus.readings import Readings
from bus.registers import RegisterFrame, Wanted, due, encode_registers, shown
from bus.specs import StallSpec
from bus.transport import Alive, Endpoint
from bus.wire import Control, DriveFrame, LinkFrame, Report, SenseFrame

_POLL_S: Final = 0.01
_LINK_POLL_S: Final = 0.001
"""How often to look for messages where they come after the senses, as no cell of ours sends them."""
_SHOW_S: Final = 0.2
"""How often to look whether somebody wants to see the cells' registers, and how often they are shown then."""


Own = tuple[NDArray[np.int64], Mapping[str, NDArray[Any]]]


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
class Member:
    """Gathers what a shard's cells sense and hear, and publishes what they drive and say.

    Blocking; one thread at a time, but ``publish`` may be called from another while ``gather`` waits for the tick
    after. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The endpoint of the shard's process.
        partition: How the cells are cut into shards; the same on all sides.
        shard: Which of them this is.
        form: ``"packed"`` or ``"cells"``; the same on all sides.
        run: Name of the run.
        readings: What sense frames carry.
        message: The firmware's message type, None where cells send each other nothing.
        stall: Deadlines.
        silence_s: Wall seconds in ``gather`` after which the plant counts as lost although its token stands;
            None: as long as the token stands. A paused or compiling plant is silent too.
        wanted: Registers of the cells that the plant wants to see.
        tally: What else to report as the shard leaves: numbers that the cells counted, by name.
        keeps: Whether the plant may ask what the shard remembers.
        joins: Whether it comes into a run that goes on already: it takes part once ``join`` says so.
        clock: Monotonic wall seconds.

    Attributes:
        counts: Payloads of this side so far.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        partition: Partition,
        shard: int,
        form: FormName,
        *,
        run: str,
        readings: Readings,
        message: np.dtype[Any] | None,
        stall: StallSpec | None = None,
        silence_s: float | None = None,
        wanted: Sequence[Wanted] = (),
        tally: Callable[[], Mapping[str, int]] = dict[str, int],
        keeps: bool = False,
        joins: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        wiring = Wiring(run, partition, readings, message)
        self._endpoint = endpoint
        self._lattice = partition.lattice
        self._shard = shard
        self._stall = StallSpec() if stall is None else stall
        self._silence_s = silence_s
        self._tally = tally
        self._clock = clock
        self._message = wiring.message
        self._form: MemberForm = FORMS[form].member(wiring, shard)
        self.counts = Counts()
        self._cells = partition.cells(shard)
        self._tick = 0
        self._lives = Lives(len(partition.lattice))
        self._outgoing = Outgoing(endpoint, wiring, shard, self._form, self._lives)
        self._senses = Collector("sense", self._form.blank_senses, self._form.decode_sense, self.counts)
        self._links = Collector("link", self._form.blank_links, self._form.decode_link, self.counts)
        if joins:
            self._senses.await_first()
            self._links.await_first()
        self._stop: Control | None = None
        self._faults: list[Control] = []
        self._joining: list[Control] = []
        self._joined: int | None = None
        self._first = 0
        self._resumed = False
        self._asked = -1
        """The tick before which the plant wants to know what the shard remembers."""
        self._taken_in = 0
        """What the shard had taken in when all of the tick before that was there."""
        self._plant_seen = False
        self._plant_lost = False
        self._declared: list[str] = []
        self._plant_key = plant_key(run, "alive")
        control = plant_key(run, "control")
        self._inbox = Dispatcher(endpoint, self.counts, self._take_token)
        self._inbox.routes = {
            **{key: (self._senses.take, unit) for key, unit in self._form.sense_units.items()},
            **{key: (self._links.take, part) for key, part in self._form.in_parts.items()},
            control: (self._take_control, 0),
        }
        for key in self._form.sense_units:
            endpoint.subscribe(key)
        # The plant senses again only when all drives have come, and messages are put before drives: they are there
        # when the senses are.
        for key in self._form.in_parts:
            endpoint.subscribe(key, "quiet")
        endpoint.subscribe(control, "urgent")
        self._report = endpoint.publisher(shard_key(run, shard, "report"))
        self._registers = endpoint.publisher(shard_key(run, shard, "registers"))
        self._memory = endpoint.publisher(shard_key(run, shard, "memory")) if keeps else None
        self._wanted = tuple(wanted)
        self._show_next = 0.0
        endpoint.watch_alive(self._plant_key)

    # --- the start ------------------------------------------------------------------------------

    def ready(self, deadline_s: float | None = None) -> None:
        """Shows that the cells are here, waits until all whom they talk to listen, and says they are ready.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Raises:
            BarrierError: The plant or a neighbour does not listen in time; names the keys.
            HostLostError: The plant went away.
            WokenError: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        self._show(self._form.alive_keys)
        waiting = {**self._outgoing.publishers, "report": self._report}
        if self._wanted:
            waiting["registers"] = self._registers
        if self._memory is not None:
            waiting["memory"] = self._memory
        while True:
            waiting = {key: publisher for key, publisher in waiting.items() if not publisher.matched()}
            if not waiting and self._plant_seen:
                break
            left = deadline - self._clock()
            if left <= 0:
                keys = ", ".join(list(waiting)[:8])
                why = f"nobody listens to {keys}" if self._plant_seen else "the plant does not answer"
                raise BarrierError(f"shard {self._shard} is not ready after {limit:g} s: {why}")
            # No event tells of a match.
            self._inbox.read(min(left, _POLL_S))
            if self._plant_lost:
                raise HostLostError("the plant left before the run began")
        self._show(self._form.ready_keys)

    def join(self, deadline_s: float | None = None) -> int | None:
        """Waits, after ``ready``, for the tick from which the shard takes part in a run that goes on already.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Returns:
            That tick; None: the run was stopped before.

        Raises:
            BarrierError: Nobody lets it take part in time.
            HostLostError: The plant went away.
            WokenError: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        while self._joined is None and self._stop is None:
            left = deadline - self._clock()
            if left <= 0:
                raise BarrierError(f"shard {self._shard} was not let in within {limit:g} s")
            self._inbox.read(left)
            if self._plant_lost:
                raise HostLostError("the plant left before the shard could take part")
        return self._joined

    def resume(self, tick: int, dead: Sequence[int]) -> None:
        """Goes on at ``tick`` where another side of the same shard was; before ``ready``.

        Args:
            tick: The first to be gathered.
            dead: Indices in the lattice of the cells that had gone before it.
        """
        self._tick, self._resumed = tick, True
        self._senses.begin(tick)
        self._links.begin(tick - 1)
        if dead:
            self.retire(dead, 0)

    def repeat(self, links: LinkFrame | None) -> None:
        """Sends the messages of the tick before the first again, which that side had sent and counted; once ready.

        Args:
            links: Those messages; None where the firmware has none.
        """
        if links is not None:
            self._endpoint.put_all(self._outgoing.link_puts(links))
        if not self.live(self._tick).any():
            self._tell_counts()

    def _show(self, keys: Iterable[str]) -> None:
        for key in keys:
            self._endpoint.declare_alive(key)
            self._declared.append(key)

    # --- a tick ---------------------------------------------------------------------------------

    def gather(self, tick: int) -> Gathered | Control:
        """Waits for what the shard needs to compute ``tick``.

        That is the tick's senses, and the link frame of the tick before from every neighbour that lived then.

        Args:
            tick: Must go up from call to call.

        Returns:
            That; or a ``stop`` record: the plant's, or this side's own when no cell of the shard takes part.

        Raises:
            HostLostError: The plant went away, or was silent for ``silence_s``.
            WokenError: ``endpoint.wake`` was called; the call may be repeated.
        """
        self._tick = tick
        if self._joining:
            self._joining = [control for control in self._joining if not self._offer(control)]
        sense = self._senses.slot(tick)
        # At its first tick nobody has sent it anything.
        links = None if self._message is None or tick == self._first else self._links.slot(tick - 1)
        deadline = None if self._silence_s is None else self._clock() + self._silence_s
        read = self._inbox.read
        while True:
            waits = sense.missing > 0
            missing = waits or (links is not None and links.missing > 0)
            if self._stop is not None:
                return self._stop
            if not self._lives.all and not self.live(tick).any():
                return Control("stop", tick, (), "no cell of this shard takes part any more")
            if not missing:
                return self._hand_over(tick)
            if self._plant_lost:
                raise HostLostError(f"the plant left; shard {self._shard} waited for tick {tick}")
            left = None if deadline is None else max(deadline - self._clock(), 0.0)
            if not waits:
                # Messages after the senses wake nobody.
                left = _LINK_POLL_S if left is None else min(left, _LINK_POLL_S)
            if not read(left, max(sense.missing, 1)) and left == 0:
                raise HostLostError(
                    f"the plant was silent for {self._silence_s:g} s; shard {self._shard} waited for tick {tick}"
                )

    def _hand_over(self, tick: int) -> Gathered:
        if tick + 1 == self._asked:
            early = 0 if self._message is None else self._links.early(tick)
            self._taken_in = self.counts.delivered - early
        senses = self._form.join_senses(self._senses.close(tick).values)
        if not self._lives.all:
            gone = ~self.live(tick)
            for sensed in (senses.presence, senses.encoder_m, senses.level, senses.label):
                if sensed is not None:
                    sensed[gone] = 0
        sense = SenseFrame(tick, *senses)
        if self._message is None:
            return Gathered(sense, None)
        values = self._form.blank_links if tick == self._first else self._links.close(tick - 1).values
        return Gathered(sense, LinkFrame(tick - 1, *self._form.join_links(values)))

    def take_faults(self) -> list[Control]:
        """Faults that somebody injected or repaired since the last call; they act from the tick gathered last on."""
        if not self._faults:
            return []
        faults, self._faults = self._faults, []
        return faults

    def _offer(self, joining: Control) -> bool:
        """Tells the plant that cells that come back can be sent to, if they can."""
        cells = [self._lattice.index(cell) for cell in joining.cells]
        if not all(publisher.matched() for publisher in self._outgoing.towards(cells)):
            return False
        self._report.put(wire.encode_report(Report("linked", self._tick, joining.cells)))
        self.counts.sent += 1
        return True

    def publish(self, drive: DriveFrame, links: LinkFrame | None) -> None:
        """Sends a tick's messages, then its drives; before the last that any cell of the shard drives, the counts.

        They would not arrive if the process were killed when its cells are dead, as a scheduled crash does.

        Args:
            drive: ``(n, 2)``, rows in the order of ``partition.cells(shard)``.
            links: In the order of ``partition.outgoing(shard)``; None where the firmware has no messages.

        Raises:
            BusError: A shape or type is not what was agreed, or a drive is not finite; names the cell.
        """
        puts = self._outgoing.puts(drive, links)
        self.counts.sent += len(puts)
        if not self._lives.all and not self.live(drive.tick + 1).any():
            self._tell_counts()
        self._endpoint.put_all(puts)

    def keep(self, tick: int, read: Callable[[], bytes]) -> None:
        """Tells the plant what the shard remembers before ``tick``, if it has asked.

        Call it after ``publish`` of the tick before.

        Args:
            tick: The next.
            read: Gives the state; asked only where the plant has.
        """
        if tick != self._asked or self._memory is None:
            return
        counts = self.counts
        self._memory.put(
            encode_kept(Kept(tick, (counts.sent, self._taken_in, counts.lost, counts.late), read()))
        )

    def show(self, tick: int, read: Callable[[], Own]) -> None:
        """Puts the registers of the cells, if the plant or somebody else wants to see them.

        Call it before ``publish`` of that tick: then the plant has them when it has its drives.

        Args:
            tick: That they have computed.
            read: Gives who they are, ``(n, 2)`` row and column, and their registers by name, arrays with a row for
                each; asked only where somebody wants to see.
        """
        wanted = due(self._wanted, tick)
        if (wanted is None or wanted.names is not None) and self._watched():
            wanted = Wanted(1)
        if wanted is None:
            return
        cells, registers = read()
        if wanted.names is not None:
            registers = {name: array for name, array in registers.items() if name in wanted.names}
        self._registers.put(encode_registers(RegisterFrame(tick, cells, shown(registers))))
        self.counts.sent += 1

    def _watched(self) -> bool:
        """Whether somebody may want to see all registers now: looked up a few times a second."""
        now = self._clock()
        if now < self._show_next:
            return False
        self._show_next = now + _SHOW_S
        return self._registers.matched()

    # --- who takes part -------------------------------------------------------------------------

    def plan(self, cells: Iterable[int], tick: int) -> None:
        """Nobody waits for ``cells`` (indices in the lattice) from ``tick`` on: a scheduled death."""
        self._lives.plan(cells, tick)
        self._bury()

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """Nobody waits for ``cells`` (indices in the lattice) from ``tick`` on; their process may come back."""
        self._lives.retire(cells, tick)
        self._bury()

    def _bury(self) -> None:
        last, form = self._lives.last, self._form
        self._senses.bury(last(form.unit_cells))
        # What is sent in tick k is read in k + 1: nobody sends to a cell that will not read.
        sources, targets = last(form.in_sources), last(form.in_targets)
        self._links.bury([min(source, target - 1) for source, target in zip(sources, targets, strict=True)])
        self._outgoing.bury()

    def live(self, tick: int) -> wire.Mask:
        """``(n,)``: the shard's cells that take part in ``tick``."""
        return self._lives.live(tick)[self._cells]

    def fail(self, cells: Iterable[int], tick: int, detail: str) -> None:
        """Tells the plant that ``cells`` (indices in the lattice) can't do ``tick``.

        Call it before ``publish`` of that tick. The plant gives them up as failed; the others go on.
        """
        index = sorted(int(i) for i in cells)
        names = tuple(self._lattice.cells[i] for i in index)
        self._report.put(wire.encode_report(Report("failed", tick, names, detail)))
        self.counts.sent += 1
        self.retire(index, tick)

    def close(self) -> None:
        """Reports this side's counts and takes the tokens back."""
        self._tell_counts()
        for key in reversed(self._declared):
            self._endpoint.withdraw(key)
        self._declared.clear()

    def hang(self, cell: int, tick: int, detail: str) -> None:
        """Tells the plant that the program of ``cell`` (index in the lattice) hangs since ``tick``; the cell goes on.

        Call it before ``publish`` of that tick.
        """
        self._report.put(wire.encode_report(Report("hung", tick, (self._lattice.cells[cell],), detail)))
        self.counts.sent += 1

    def _tell_counts(self) -> None:
        counts = self.counts
        numbers = (counts.sent, counts.delivered, counts.lost, counts.late)
        report = Report("counts", self._tick, (), "", numbers, counts.tallied(self._tally()))
        self._report.put(wire.encode_report(report))

    def _admit(self, control: Control) -> None:
        """Cells take part again from a tick on, which is the next; this shard's own, or others'."""
        cells, tick = [self._lattice.index(cell) for cell in control.cells], control.tick
        self._lives.admit(cells, tick)
        if not set(cells).isdisjoint(self._cells.tolist()):
            self._first = self._joined = tick
            self._senses.begin(tick)
            self._links.begin(tick - 1)
        first, last, form = self._lives.first, self._lives.last, self._form
        self._senses.admit(first(form.unit_cells), last(form.unit_cells))
        sources, targets = form.in_sources, form.in_targets
        since = [max(pair) for pair in zip(first(sources), first(targets), strict=True)]
        until = [min(s, t - 1) for s, t in zip(last(sources), last(targets), strict=True)]
        self._links.admit(since, until)
        self._outgoing.bury()

    # --- events ---------------------------------------------------------------------------------

    def _take_token(self, event: Alive) -> None:
        # Somebody else's token is none of ours.
        if event.key == self._plant_key:
            self._plant_lost = self._plant_seen and not event.present
            self._plant_seen = self._plant_seen or event.present

    def _take_control(self, _: int, payload: bytes) -> None:
        control = wire.decode_control(payload, len(self._lattice))
        if not all(cell in self._lattice for cell in control.cells):
            raise WireError("control", "cells", "names a cell that is not in the array")
        if control.kind == "keep":
            self._asked = control.tick
            return  # no part of the lockstep, and not counted
        if control.kind == "start" and self._resumed:
            return  # counted when the run began
        if control.kind == "stop":
            self._stop = control
        elif control.kind == "fault":
            own = {self._lattice.index(cell) for cell in control.cells}
            if not own or not own.isdisjoint(self._cells.tolist()):
                self._faults.append(control)
        elif control.kind == "joining":
            self._joining.append(control)
            back = {self._lattice.index(cell) for cell in control.cells}
            sources = enumerate(self._form.in_sources)
            self._links.expect(part for part, cells in sources if not back.isdisjoint(cells.tolist()))
        elif control.kind == "joined":
            self._admit(control)
        elif control.kind == "lost":
            waited = len(self._links.missing(self._links.now))
            lost = [self._lattice.index(cell) for cell in control.cells]
            self.retire(lost, control.tick)
            self.counts.lost += waited - len(self._links.missing(self._links.now))
            # What they sent before has arrived, or will; of the tick in which they were lost it may have, or not: it
            # never was.
            gone = [part for part, until in enumerate(self._links.until) if until <= control.tick]
            self._links.void(gone, control.tick)
        self.counts.delivered += 1
