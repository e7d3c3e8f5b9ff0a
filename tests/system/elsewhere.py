"""The two halves of a run in two network namespaces; they meet in a file and over the bus.

python -m tests.system.elsewhere plant FOLDER SCENE ENDPOINT [PROCESSES]   # prints the summary
python -m tests.system.elsewhere cells FOLDER
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deploy.workers.plan import Processes

_ORDER = "order.pickle"


class Elsewhere:
    """In place of the workers' processes: writes their order to a file, for whoever is to carry it out."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def start(self, order: Callable[[int], None]) -> None:
        written = self._folder / "order.part"
        written.write_bytes(pickle.dumps(order))
        written.rename(self._folder / _ORDER)

    def trouble(self, timeout_s: float) -> bool:
        threading.Event().wait(timeout_s)
        return False

    def check(self) -> None: ...

    def details(self) -> str:
        return ""

    def close(self, grace_s: float) -> None: ...


def plant(folder: Path, scene: str, join: str, processes: Processes = "each") -> None:
    """As ``mdms run --processes PROCESSES --join``, but for the workers."""
    from deploy.runs.run import run
    from deploy.scenes.files import load_scene
    from deploy.workers import system
    from deploy.workers.plan import RunOptions

    system.WorkerProcesses = lambda *_: Elsewhere(folder)  # type: ignore[assignment,misc]
    options = RunOptions(processes, join=join, output=folder / "out", picture=False, insecure=True)
    outcome = run(load_scene(scene), options, quiet=True)
    print(outcome.summary.to_json())


def cells(folder: Path) -> None:
    """A process a shard, as the plant orders."""
    import bus.transports.zenoh  # noqa: F401 - once, before the forks

    while not (folder / _ORDER).exists():
        time.sleep(0.01)
    order = pickle.loads((folder / _ORDER).read_bytes())
    children: list[int] = []
    for shard in range(order.partition.count):
        child = os.fork()
        if child == 0:
            try:
                order(shard)
            finally:
                os._exit(0)
        children.append(child)
    for child in children:
        os.waitpid(child, 0)


if __name__ == "__main__":
    if sys.argv[1] == "plant":
        plant(Path(sys.argv[2]), sys.argv[3], sys.argv[4], *map(int, sys.argv[5:]))
    else:
        cells(Path(sys.argv[2]))
