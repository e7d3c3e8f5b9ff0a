"""Presence of the processes of cells, by their tokens, at any time and beside the lockstep."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

if TYPE_CHECKING:
    from bus.partition import Partition
    from bus.transports.zenoh import ZenohEndpoint


@final
class Presence:
    """Tokens of a run's cells and of processes that were started by hand; may be read by any thread.

    Args:
        endpoint: Endpoint of the plant.
        run: Name of the run.
        partition: Cells of each shard.
    """

    def __init__(self, endpoint: ZenohEndpoint, run: str, partition: Partition) -> None:
        self._partition = partition
        self._lock = threading.Lock()
        self._tokens: dict[str, set[int]] = {"alive": set(), "ready": set()}
        """Cells (indices) whose token of that name is there."""
        self._processes: dict[int, set[str]] = {}
        self._subscriber: Any = cast("Any", endpoint.session.liveliness()).declare_subscriber(
            f"mdms/{run}/**", handlers.Callback(self._take, indirect=False), history=True
        )

    def shards(self, token: str) -> set[int]:
        """Return the shards all of whose cells show a token, ``alive`` or ``ready``."""
        with self._lock:
            cells = self._tokens[token]
            count, own = self._partition.count, self._partition.cells
            return {shard for shard in range(count) if cells.issuperset(own(shard).tolist())}

    def any_alive(self, shard: int) -> bool:
        """Whether a cell of the shard is alive."""
        with self._lock:
            return not self._tokens["alive"].isdisjoint(self._partition.cells(shard).tolist())

    def process_is_there(self, shard: int, process: str) -> bool:
        """Whether a process that was started by hand for a shard shows its token."""
        with self._lock:
            return process in self._processes.get(shard, ())

    def close(self) -> None:
        """Stop watching."""
        self._subscriber.undeclare()

    def _take(self, sample: zenoh.Sample) -> None:
        """Note a change of a token; runs in one of Zenoh's threads."""
        present = sample.kind == zenoh.SampleKind.PUT
        with self._lock:
            match str(sample.key_expr).split("/")[2:]:
                case ["shard", shard, "process", process] if self._is_shard(shard):
                    found = self._processes.setdefault(int(shard), set())
                    (found.add if present else found.discard)(process)
                case ["shard", shard, ("alive" | "ready") as token] if self._is_shard(shard):
                    cells = self._partition.cells(int(shard)).tolist()
                    (self._tokens[token].update if present else self._tokens[token].difference_update)(cells)
                case ["cell", row, column, ("alive" | "ready") as token]:
                    self._note_cell(row, column, token, present=present)
                case _:
                    pass

    def _is_shard(self, text: str) -> bool:
        return text.isascii() and text.isdigit() and int(text) < self._partition.count

    def _note_cell(self, row: str, column: str, token: str, *, present: bool) -> None:
        lattice = self._partition.lattice
        if not (row.isascii() and row.isdigit() and column.isascii() and column.isdigit()):
            return
        cell = (int(row), int(column))
        if cell in lattice:
            found = self._tokens[token]
            (found.add if present else found.discard)(lattice.index(cell))
