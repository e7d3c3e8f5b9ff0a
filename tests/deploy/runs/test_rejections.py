"""What a run refused: reported once for each peer and kind, counted for the summary, shown in its table."""

from __future__ import annotations

import io
from collections import Counter
from typing import Any, cast

from rich.console import Console

from bus.lockstep.counters import MessageCounters
from deploy.runs.rejections import DENIED, MALFORMED, MESSAGE, RejectionMonitor, total
from deploy.runs.summary import Messages
from deploy.runs.summary_table import print_summary
from tests.deploy.runs.test_summary import summary


class Watched:
    """Stands for what Zenoh refuses."""

    def __init__(self) -> None:
        self.fresh = False
        self.counts: Counter[tuple[str, str]] = Counter()

    def refuse(self, whose: str, what: str) -> None:
        self.fresh = True
        self.counts[whose, what] += 1

    def counted(self) -> dict[tuple[str, str], int]:
        self.fresh = False
        return dict(self.counts)


def test_each_peer_and_kind_is_reported_once_and_counted_every_time() -> None:
    watch, counts, reported = Watched(), MessageCounters(), list[str]()
    refused = RejectionMonitor(cast("Any", watch), reported.append)
    for _ in range(3):
        watch.refuse("cells-0", MESSAGE)
        watch.refuse("a stranger", "connection: no certificate")
        counts.refused["shard 0", "drive: type"] += 1
        refused.poll(counts)
    counts.refused["shard 1", "drive: type"] += 1
    refused.poll(counts)
    assert reported == [
        "refused: shard 0: drive: type malformed (the summary has the number)",
        "denied: cells-0: message (the summary has the number)",
        "denied: a stranger: connection: no certificate (the summary has the number)",
        "refused: shard 1: drive: type malformed (the summary has the number)",
    ]
    rows = refused.summary_rows(counts)
    assert [(row["why"], row["whose"], row["what"], row["number"]) for row in rows] == [
        (MALFORMED, "shard 0", "drive: type", 3),
        (MALFORMED, "shard 1", "drive: type", 1),
        (DENIED, "a stranger", "connection: no certificate", 3),
        (DENIED, "cells-0", MESSAGE, 3),
    ]
    assert (total(rows, DENIED, MESSAGE), total(rows, DENIED), total(rows, MALFORMED)) == (3, 6, 4)


def test_the_table_has_a_line_for_each_who_was_refused_something() -> None:
    rows = [
        {"why": DENIED, "whose": "cells-0", "what": MESSAGE, "number": 1_200},
        {"why": MALFORMED, "whose": "shard 0", "what": "drive: type", "number": 2},
        {"why": DENIED, "whose": "cells-0", "what": "no role", "number": 1},
    ]
    outcome = summary(messages=Messages(sent=5, delivered=4, denied=1_200, malformed=2), refused=rows)
    console = Console(file=io.StringIO(), width=100)
    print_summary(outcome, console)
    text = " ".join(cast("io.StringIO", console.file).getvalue().split())
    assert "5 sent on the bus, 4 delivered, 1,200 denied, 2 malformed" in text
    assert "refused cells-0: message denied 1,200 ×; no role denied 1 ×" in text
    assert "refused shard 0: drive: type malformed 2 ×" in text
