"""What the lockstep costs over a bare Zenoh exchange of the same payloads.

``python tests/benchmarks/lockstep.py`` measures and prints its method. Both sides run the same processes on the
same sessions' settings; a *side* is one way to run a case (``SIDES``), so that another can be put beside them.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import queue
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from zenoh import handlers

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bus.forms import FORMS, FormName
from bus.forms.form import Wiring
from bus.lattice import Lattice
from bus.lockstep import Host, Member
from bus.partition import Partition
from bus.transports.zenoh import open_client, open_hub
from bus.wire import Control, DriveFrame, LinkFrame, SenseFrame

MESSAGE = np.dtype([("u", "<f8")])
RUN = "benchmark"
SENSORS = 1


@dataclass(frozen=True)
class Rate:
    """What a side reached: ticks a wall second, and processor microseconds a tick of all its processes."""

    ticks_per_s: float
    cpu_us: float


@dataclass(frozen=True)
class Case:
    """One exchange to measure; ``target`` is the least ratio to the bare exchange, None where it is only printed."""

    title: str
    rows: int
    columns: int
    workers: int
    form: FormName
    ticks: int
    target: float | None

    def partition(self) -> Partition:
        lattice = Lattice((r, c) for r in range(self.rows) for c in range(self.columns))
        return Partition.even(lattice, self.workers)

    def wiring(self) -> Wiring:
        return Wiring(RUN, self.partition(), SENSORS, True, MESSAGE)


CASES = (
    Case("18 cells, 1 worker, packed", 3, 6, 1, "packed", 2000, 1 / 2.5),
    Case("1,024 cells, 2 workers, packed", 32, 32, 2, "packed", 1000, None),
    Case("18 cells, one process a cell", 3, 6, 18, "cells", 500, 0.6),
)

METHOD = """\
Method. Lockstep of one plant and its workers over Zenoh, TCP on loopback; the plant's session is a peer that listens,
each worker a process of its own, client of it. A tick: senses (presence bits, encoder travel) to every worker,
messages ("u", float64) over every link that crosses a border, drives back. The bare side is plain Zenoh code
(FifoChannel, recv, put) that exchanges payloads of the same number and sizes and reads none of them; the lockstep
side is bus.lockstep with cells that compute nothing. The sides take turns; medians of {repeat} runs of each.
"cpu" is processor time a tick of all processes together, which a busy machine disturbs less than the rate.
"""


# --- the bare exchange ----------------------------------------------------------------------------


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        reliability=zenoh.Reliability.RELIABLE,
    )


def bare_worker(case: Case, shard: int, locator: str) -> None:
    """Waits for a sense a unit and a payload a link that comes in; answers with as many as the form has."""
    form = FORMS[case.form].member(case.wiring(), shard)
    endpoint = open_client(locator)
    session = endpoint.session
    rows, links = len(case.partition().cells(shard)), len(case.partition().outgoing(shard))
    drives = form.drive_payloads(DriveFrame(1000, np.full((rows, 2), 0.1)))
    frame = LinkFrame(1000, np.ones(links, dtype=np.bool_), np.full(links, 0.1).view(MESSAGE))
    messages = form.link_payloads(frame)
    sense = session.declare_subscriber(f"bare/{shard}/sense/*", handlers.FifoChannel(4096))
    heard = session.declare_subscriber(f"bare/{shard}/link/*/*", handlers.FifoChannel(4096))
    stop = session.declare_subscriber("bare/stop", handlers.FifoChannel(1))
    drive_puts = [_publisher(session, f"bare/drive/{shard}/{i}") for i in range(len(drives))]
    shard_of = case.partition().shard_of
    link_puts = [
        _publisher(session, f"bare/{shard_of[targets[0]]}/link/{shard}/{i}")
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
    print(time.process_time() - spent)
    del token
    endpoint.close()


def bare_rate(case: Case) -> Rate:
    """The bare exchange."""
    form = FORMS[case.form].host(case.wiring())
    cells = len(case.partition().lattice)
    senses = form.sense_payloads(
        SenseFrame(1000, np.zeros((cells, SENSORS), dtype=np.bool_), np.full((cells, 2), 0.1))
    )
    hub = open_hub()
    session = hub.session
    ready: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    drives = session.declare_subscriber("bare/drive/*/*", handlers.FifoChannel(4096))
    watch = session.liveliness().declare_subscriber(
        "bare/ready/*", handlers.Callback(ready.put, indirect=False), history=True
    )
    shard_of = case.partition().shard_of
    puts = [
        _publisher(session, f"bare/{shard_of[unit_cells[0]]}/sense/{i}")
        for i, unit_cells in enumerate(form.unit_cells)
    ]
    stop = _publisher(session, "bare/stop")
    processes = start_workers("bare", case, hub.locator)
    for _ in processes:
        ready.get(timeout=30)
    while not all(p.matching_status.matching for p in puts):
        time.sleep(0.01)

    def tick() -> None:
        for publisher, payload in zip(puts, senses, strict=True):
            publisher.put(payload)
        for _ in senses:
            drives.recv().payload.to_bytes()

    def end() -> None:
        stop.put(b"")
        for publisher, payload in zip(puts, senses, strict=True):
            publisher.put(payload)

    rate = measure(case, lambda _: tick(), processes, end)
    watch.undeclare()
    hub.close()
    return rate


# --- the lockstep -----------------------------------------------------------------------------------


def lockstep_worker(case: Case, shard: int, locator: str) -> None:
    """Cells that compute nothing."""
    endpoint = open_client(locator)
    partition = case.partition()
    member = Member(
        endpoint, partition, shard, case.form, run=RUN, sensors=SENSORS, encoders=True, message=MESSAGE
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
    print(time.process_time() - spent)
    member.close()
    endpoint.close()


def lockstep_rate(case: Case) -> Rate:
    """The lockstep."""
    hub = open_hub()
    partition = case.partition()
    host = Host(hub, partition, case.form, run=RUN, sensors=SENSORS, encoders=True, message=MESSAGE)
    processes = start_workers("lockstep", case, hub.locator)
    host.barrier()
    cells = len(partition.lattice)
    presence, encoder_m = np.zeros((cells, SENSORS), dtype=np.bool_), np.full((cells, 2), 0.1)

    def tick(k: int) -> None:
        host.publish(SenseFrame(k, presence, encoder_m))
        _, losses = host.gather(k)
        if losses:
            raise SystemExit(f"a worker was lost: {losses[0]}")

    rate = measure(case, tick, processes, lambda: host.control(Control("stop", 0)))
    host.close()
    hub.close()
    return rate


# --- both ---------------------------------------------------------------------------------------------

SIDES: dict[str, Callable[[Case], Rate]] = {"bare": bare_rate, "lockstep": lockstep_rate}
WORKERS = {"bare": bare_worker, "lockstep": lockstep_worker}


def measure(
    case: Case, tick: Callable[[int], None], workers: list[subprocess.Popen[str]], end: Callable[[], None]
) -> Rate:
    """Runs the ticks, after a tenth of them to warm up; then ends the workers and adds up what they spent."""
    warm = case.ticks // 10
    spent = time.process_time()
    for k in range(warm):
        tick(k)
    start = time.perf_counter()
    for k in range(warm, warm + case.ticks):
        tick(k)
    wall = time.perf_counter() - start
    spent = time.process_time() - spent
    end()
    spent += sum(float(worker.communicate(timeout=10)[0]) for worker in workers)
    return Rate(case.ticks / wall, 1e6 * spent / (warm + case.ticks))


def start_workers(side: str, case: Case, locator: str) -> list[subprocess.Popen[str]]:
    """A process a shard, from a command line: nothing is inherited."""
    order = json.dumps({"side": side, "case": asdict(case), "locator": locator})
    return [
        subprocess.Popen(
            [sys.executable, __file__, "--worker", order, "--shard", str(shard)],
            stdout=subprocess.PIPE,
            text=True,
            # real workers are forked, and a fork has none of these threads
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        for shard in range(case.workers)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3, help="runs of each side")
    parser.add_argument("--case", type=int, action="append", help=f"only this case, 0..{len(CASES) - 1}")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--shard", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker is not None:
        order = json.loads(options.worker)
        # as real workers are: what the imports left behind is not looked at again, tick after tick
        gc.collect()
        gc.freeze()
        WORKERS[order["side"]](Case(**order["case"]), options.shard, order["locator"])
        return
    rows = [run_case(case, options.repeat) for case in (CASES[i] for i in options.case or range(len(CASES)))]
    if options.json:
        print(json.dumps(rows, default=asdict))
        return
    print(METHOD.format(repeat=options.repeat))
    head = "".join(f"{side + ', ticks/s':>20}{'cpu, us':>9}" for side in SIDES)
    print(f"{'case':32}{head}{'ratio':>8}{'cpu':>6}  target")
    for row in rows:
        rates = "".join(f"{row[side].ticks_per_s:20.0f}{row[side].cpu_us:9.0f}" for side in SIDES)
        target = "-" if row["target"] is None else f">= {row['target']:.2f}"
        print(f"{row['case']:32}{rates}{row['ratio']:8.2f}{row['cpu_ratio']:6.2f}  {target}")


def run_case(case: Case, repeat: int) -> dict[str, Any]:
    """Median rates of every side, and the last's ratios to the first."""
    rates: dict[str, list[Rate]] = {side: [] for side in SIDES}
    for _ in range(repeat):
        for side, rate in SIDES.items():
            rates[side].append(rate(case))
    medians = {
        side: Rate(
            statistics.median(r.ticks_per_s for r in values), statistics.median(r.cpu_us for r in values)
        )
        for side, values in rates.items()
    }
    bare, lockstep = medians["bare"], medians["lockstep"]
    return {
        "case": case.title,
        **medians,
        "ratio": lockstep.ticks_per_s / bare.ticks_per_s,
        "cpu_ratio": bare.cpu_us / lockstep.cpu_us,
        "target": case.target,
    }


if __name__ == "__main__":
    main()
