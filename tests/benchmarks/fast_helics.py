"""The HELICS side of ``fast.py``: federates that compute nothing, one a process, and a plant's federate.

A tick is a time step of all federates. The plant publishes a value for each cell; a cell publishes its drive and a
value for each neighbour. Values are read in the next step, so that a tick is one grant of time, not a round trip: less
than the lockstep of a run waits for. Needs ``pip install helics``. Each measurement has processes of its own, since
federates that wait take processor time.
"""

from __future__ import annotations

import itertools
import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

WARM_TICKS = 5


def helics_rate(neighbours: list[list[int]], sense: int, drive: int, seconds: float) -> float:
    """Return ticks a second of the HELICS side, with processes of its own.

    Args:
        neighbours: Numbers of the neighbours of each cell.
        sense: Size of the value for a cell, bytes.
        drive: Size of a cell's drive, bytes.
        seconds: Wall time to measure.
    """
    arguments = json.dumps([neighbours, sense, drive, seconds])
    command = [sys.executable, "-c", "import fast_helics; fast_helics.main()", arguments]
    done = subprocess.run(command, cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout)


class _Exchange:
    """The plant's federate, a broker in this process, and a process a cell."""

    def __init__(self, neighbours: list[list[int]], sense: int, drive: int) -> None:
        import helics

        self._helics: Any = helics
        cells = len(neighbours)
        port = 23_500 + os.getpid() % 4_000
        self._broker = helics.helicsCreateBroker(
            "zmq", "", f"-f {cells + 1} --port={port} --loglevel=no_print"
        )
        context = multiprocessing.get_context("spawn")
        self._workers = [
            context.Process(
                target=_work,
                args=(cell, neighbours[cell], drive, port),
                daemon=True,
            )
            for cell in range(cells)
        ]
        for worker in self._workers:
            worker.start()
        self._federate = _federate(helics, "plant", port)
        self._senses = [
            helics.helicsFederateRegisterGlobalPublication(
                self._federate, f"sense/{cell}", helics.HELICS_DATA_TYPE_RAW
            )
            for cell in range(cells)
        ]
        self._drives = [
            helics.helicsFederateRegisterSubscription(self._federate, f"drive/{cell}", "")
            for cell in range(cells)
        ]
        self._payload = bytes(sense)
        helics.helicsFederateEnterExecutingMode(self._federate)

    def tick(self) -> None:
        """Publish all senses, advance the time, and read all drives."""
        helics = self._helics
        for publication in self._senses:
            helics.helicsPublicationPublishBytes(publication, self._payload)
        helics.helicsFederateRequestNextStep(self._federate)
        for drive in self._drives:
            helics.helicsInputGetBytes(drive)

    def close(self) -> None:
        """End the processes, then the federate and the broker."""
        for worker in self._workers:
            worker.kill()
            worker.join()
        self._helics.helicsBrokerDisconnect(self._broker)
        self._helics.helicsCloseLibrary()


def _federate(helics: Any, name: str, port: int) -> Any:
    info = helics.helicsCreateFederateInfo()
    helics.helicsFederateInfoSetCoreTypeFromString(info, "zmq")
    helics.helicsFederateInfoSetCoreInitString(info, f"--federates=1 --brokerport={port} --loglevel=no_print")
    helics.helicsFederateInfoSetTimeProperty(info, helics.HELICS_PROPERTY_TIME_PERIOD, 1.0)
    return helics.helicsCreateValueFederate(name, info)


def _work(cell: int, neighbours: list[int], size: int, port: int) -> None:
    """Publish a drive and a value for each neighbour in every step, and read those of the step before."""
    import helics

    time.sleep(0.01 * cell)  # a broker refuses connections that come all at once
    federate = _federate(helics, f"cell{cell}", port)
    drive = helics.helicsFederateRegisterGlobalPublication(
        federate, f"drive/{cell}", helics.HELICS_DATA_TYPE_RAW
    )
    sends = [
        helics.helicsFederateRegisterGlobalPublication(
            federate, f"link/{cell}/{other}", helics.HELICS_DATA_TYPE_RAW
        )
        for other in neighbours
    ]
    heard = [helics.helicsFederateRegisterSubscription(federate, f"sense/{cell}", "")]
    heard += [
        helics.helicsFederateRegisterSubscription(federate, f"link/{other}/{cell}", "")
        for other in neighbours
    ]
    helics.helicsFederateEnterExecutingMode(federate)
    payload, message = bytes(size), bytes(9)
    while True:
        helics.helicsPublicationPublishBytes(drive, payload)
        for publication in sends:
            helics.helicsPublicationPublishBytes(publication, message)
        helics.helicsFederateRequestNextStep(federate)
        for value in heard:
            helics.helicsInputGetBytes(value)


def main() -> None:
    """Measure in this process; arguments as of ``helics_rate``, in JSON."""
    neighbours, sense, drive, seconds = json.loads(sys.argv[1])
    exchange = _Exchange(neighbours, sense, drive)
    for _ in range(WARM_TICKS):
        exchange.tick()
    begun = time.perf_counter()
    for ticks in itertools.count(1):
        exchange.tick()
        if ticks > 1 and time.perf_counter() - begun >= seconds:
            break
    print(ticks / (time.perf_counter() - begun), flush=True)
    exchange.close()
