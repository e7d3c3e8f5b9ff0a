"""Processes of cells as ``mdms cells`` starts them, forked from one that has imported what they need.

python -m tests.system.joining SCENE ENDPOINT N|each RUN [SHARD...]   # default: all shards
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from bus.partition import Partition
from deploy.scenes.files import load_scene
from deploy.util.formatting import silent
from deploy.util.signals import Interruption
from deploy.workers.shard_process import ShardProcess


def main(scene: str, connect: str, shards: str, run: str, *chosen: str) -> int:
    """Fork a process a shard, and wait for all of them; return the number of those that failed."""
    import bus.transports.zenoh  # noqa: F401 - once, before the forks
    from cell_firmware.loader import load

    made = load_scene(scene)
    load(made.cells)
    lattice = made.lattice()
    partition = Partition.even(lattice, len(lattice) if shards == "each" else int(shards))
    children = [
        _forked(ShardProcess(made, partition, shard, run, connect, None, silent))
        for shard in (map(int, chosen) if chosen else range(partition.count))
    ]
    return sum(os.waitpid(child, 0)[1] != 0 for child in children)


def command(
    scene: object, connect: str, shards: int | str, run: str, chosen: Sequence[int] = ()
) -> list[str]:
    """The command line of ``main``."""
    words = [scene, connect, shards, run, *chosen]
    return [sys.executable, "-m", "tests.system.joining", *map(str, words)]


def plant_command(scene: object, listen: str, shards: int | str, folder: object) -> list[str]:
    """The command line of a plant that such processes join, in an open network."""
    options = [
        "--shards",
        shards,
        "--listen",
        listen,
        "--insecure",
        "--output",
        folder,
        "--no-picture",
        "--json",
    ]
    return [sys.executable, "-m", "deploy.cli", "plant", *map(str, [scene, *options])]


def _forked(process: ShardProcess) -> int:
    child = os.fork()
    if child == 0:
        status = 1
        try:
            process.work(Interruption())
            status = 0
        except BaseException as error:  # noqa: BLE001 - a child never returns
            sys.stderr.write(f"{process.name}: {error!r}\n")
        finally:
            os._exit(status)
    return child


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
