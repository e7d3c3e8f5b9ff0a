"""What the worker processes of ``lockstep.py`` do; the server that forks them has imported this."""

from __future__ import annotations

import gc
import time

import numpy as np
from lockstep_bare import CAPACITY, bare_publisher
from lockstep_case import MESSAGE, RUN, SENSORS, Case
from zenoh import handlers

from bus.lockstep import Participant
from bus.sensors import SensorSchema
from bus.transports.zenoh import open_client
from bus.wire.formats import FORMATS
from bus.wire.frames import Control, DriveFrame, LinkFrame


def bare_worker(case: Case, shard: int, locator: str) -> float:
    """Waits for a sense a unit and a payload a link that comes in; answers with as many as the form has."""
    form = FORMATS[case.form].participant(case.wiring(), shard)
    endpoint = open_client(locator)
    session = endpoint.session
    rows, links = len(case.partition().cells(shard)), len(case.partition().outgoing(shard))
    frame = LinkFrame(1000, np.ones(links, dtype=np.bool_), np.full(links, 0.1).view(MESSAGE))
    drives = form.drive_payloads(DriveFrame(1000, np.full((rows, 2), 0.1)), frame)
    messages = form.link_payloads(frame)
    sense = session.declare_subscriber(f"bare/{shard}/sense/*", handlers.FifoChannel(CAPACITY))
    heard = session.declare_subscriber(f"bare/{shard}/link/*/*", handlers.FifoChannel(CAPACITY))
    stop = session.declare_subscriber("bare/stop", handlers.FifoChannel(1))
    drive_puts = [bare_publisher(session, f"bare/drive/{shard}/{i}") for i in range(len(drives))]
    shard_of = case.partition().shard_of
    link_puts = [
        bare_publisher(session, f"bare/{shard_of[targets[0]]}/link/{shard}/{i}")
        for i, targets in enumerate(form.out_targets)
    ]
    while not all(p.matching_status.matching for p in (*drive_puts, *link_puts)):
        time.sleep(0.01)
    token = session.liveliness().declare_token(f"bare/ready/{shard}")
    links_in, first = len(form.in_parts), True
    spent = time.process_time()
    while stop.try_recv() is None:
        for _ in drives:
            sense.recv().payload.to_bytes()
        for _ in range(0 if first else links_in):
            heard.recv().payload.to_bytes()
        first = False
        for publisher, payload in zip(link_puts, messages, strict=True):
            publisher.put(payload)
        for publisher, payload in zip(drive_puts, drives, strict=True):
            publisher.put(payload)
    spent = time.process_time() - spent
    del token
    endpoint.close()
    return spent


def lockstep_worker(case: Case, shard: int, locator: str) -> float:
    """Cells that compute nothing. Returns the processor seconds that the ticks took, as the other does."""
    endpoint = open_client(locator)
    partition = case.partition()
    member = Participant(
        endpoint,
        partition,
        shard,
        case.form,
        run=RUN,
        readings=SensorSchema(SENSORS, encoders=True),
        message=MESSAGE,
    )
    member.ready()
    rows, links = len(partition.cells(shard)), len(partition.outgoing(shard))
    drive = np.full((rows, 2), 0.1)
    sent, message = np.ones(links, dtype=np.bool_), np.full(links, 0.1).view(MESSAGE)
    tick = 0
    spent = time.process_time()
    while not isinstance(member.gather(tick), Control):
        member.publish(DriveFrame(tick, drive), LinkFrame(tick, sent, message))
        tick += 1
    spent = time.process_time() - spent
    member.close()
    endpoint.close()
    return spent


WORKERS = {"bare": bare_worker, "lockstep": lockstep_worker}

# As real workers' parent does: what the imports left behind is not looked at again, tick after tick.
gc.collect()
gc.freeze()
