"""Reports of failed cells, as the plant drains them."""

from __future__ import annotations

from bus.lattice import Lattice
from bus.lockstep.reports import ReportReceiver
from bus.partition import Partition
from bus.wire.frames import Report, encode_report


class _Cells(tuple[tuple[int, int], ...]):
    """Cells of a report that can't be compared or hashed, which takes a time of their number."""

    __slots__ = ()

    def __hash__(self) -> int:
        raise AssertionError("a report was hashed")

    def __eq__(self, other: object) -> bool:
        raise AssertionError("reports were compared")


def _receiver(now: int) -> ReportReceiver:
    partition = Partition.even(Lattice((row, column) for row in range(10) for column in range(20)), 2)
    return ReportReceiver(partition, lambda: now, lambda shard, cells: None)


def test_failures_come_report_by_report_once_they_are_due() -> None:
    receiver = _receiver(5)
    receiver.handle(0, encode_report(Report("failed", 5, ((0, 1), (0, 2)), "first")))
    receiver.handle(1, encode_report(Report("failed", 5, ((9, 19),), "second")))
    receiver.handle(0, encode_report(Report("failed", 5, ((0, 2), (0, 3)), "third")))
    receiver.handle(0, encode_report(Report("failed", 6, ((0, 4),), "later")))
    assert receiver.drain_failed() == [("first", [1, 2]), ("second", [199]), ("third", [3])]
    assert receiver.drain_failed() == []
    assert list(receiver.failed) == [(0, 4)]


def test_a_report_of_many_cells_is_not_looked_through_for_each_of_them() -> None:
    receiver = _receiver(5)
    report = Report("failed", 5, _Cells((row, column) for row in range(10) for column in range(10)), "all")
    receiver.failed = dict.fromkeys(tuple.__iter__(report.cells), report)
    assert receiver.drain_failed() == [
        ("all", [20 * row + column for row in range(10) for column in range(10)])
    ]
