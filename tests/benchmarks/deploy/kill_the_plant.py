"""Kills the plant's process at random instants, and holds the resumed run against the same run uninterrupted.

With ``--instants`` every run is killed several times, also while it goes on from a checkpoint and while it writes one:
after the first checkpoint that it leaves, at an instant drawn evenly from two intervals. With ``--kills`` the kills are
spread evenly over four phases: the start of a run, the start of one that is resumed, the writing of a checkpoint, and
the end.

Prints a line a kill. Fails if a digest differs, a tick is missing in the recording or there twice, a run that had left
a checkpoint can't be resumed, one that had not is refused in more than a line, more than an interval has to be done
again (and the time by which a checkpoint takes longer to write than the one before it), or a process is left.

    python tests/benchmarks/deploy/kill_the_plant.py --instants 50
    python tests/benchmarks/deploy/kill_the_plant.py --instants 50 --processes each --scene prototype
    python tests/benchmarks/deploy/kill_the_plant.py --kills 200
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.checkpoints.store import DRAFT
from deploy.checkpoints.store import FILE_NAME as CHECKPOINT
from tests.system.killed import assert_whole, ended, kill, kill_after, reached, refusal, start
from tests.system.running import Mdms

KILLS_A_RUN = 5
LATER_S = 0.1
"""Wall time by which a checkpoint may come later than the one before lets expect, on a machine that does other work."""
PACE = 2
"""Simulated seconds a wall second: a run that is over can't be killed."""
SLOWLY = 0.25
"""The same of runs that are killed in a certain phase: it is to be met on a machine that does other work, too."""
PATIENCE_S = 120.0


def main() -> int:
    """Read the options, kill, and say how often it went wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instants", type=int, default=50)
    parser.add_argument(
        "--kills", type=int, help="So many, spread over the four phases, instead of --instants."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scene", default="elliptic")
    parser.add_argument("--processes", default="1")
    parser.add_argument("--transport", default="zenoh")
    parser.add_argument("--duration", type=float, help="Default: 6; with --kills 2.")
    parser.add_argument("--checkpoint", type=float, default=0.25)
    parser.add_argument("--limit", type=float, default=3600.0, help="Begin no run after so many seconds.")
    asked = parser.parse_args()
    asked.duration = asked.duration or (2.0 if asked.kills else 6.0)
    draw, begun = np.random.default_rng(asked.seed), time.monotonic()
    scene = (asked.scene, "--duration", asked.duration, "--processes", asked.processes)
    scene = (*scene, "--transport", asked.transport)
    with tempfile.TemporaryDirectory() as folder:
        whole = ended(start(Path(folder), *scene, "--output", folder))
    wanted, killed, lives = asked.kills or asked.instants, 0, _Lives(scene, asked, draw, whole)
    while killed < wanted and time.monotonic() < begun + asked.limit:
        left = wanted - killed
        if asked.kills:
            killed += lives.one(left)
        else:
            killed += _one(scene, asked, draw, min(KILLS_A_RUN, left), whole)
    for (phase, became), number in sorted(lives.count.items()):
        print(f"{number:4} killed at {phase}: {became}")
    print(f"{killed} kills, every run to the digest of the uninterrupted one: {whole['digest']}")
    return 0 if killed >= wanted else 1


def _one(
    scene: tuple[Any, ...],
    asked: argparse.Namespace,
    draw: np.random.Generator,
    kills: int,
    whole: dict[str, Any],
) -> int:
    """One run, killed several times, to its end; returns how often it could be."""
    with tempfile.TemporaryDirectory() as name:
        folder, last, done = Path(name), 0, 0
        run = start(folder, *scene, "--realtime", PACE, "--checkpoint", asked.checkpoint, "--output", folder)
        while done < kills:
            delay_s = float(draw.uniform(0.0, 2.0 * asked.checkpoint))
            killed = kill_after(run, last, delay_s)
            if killed is None:
                break  # it was over before
            done += 1
            print(
                f"killed {delay_s:.3f} s after a checkpoint: goes on before tick {killed.tick}, from one that was "
                f"written {killed.age_s:.3f} s before",
                flush=True,
            )
            assert killed.age_s <= asked.checkpoint + LATER_S, "more than one interval is done again"
            last = killed.tick
            run = start(folder, "--resume", folder, *(() if done == kills else ("--realtime", PACE)))
        if done:
            _check(ended(run), whole, folder)
        return done


class _Lives:
    """Runs that are killed once in each phase, one run after the other.

    Args:
        scene: Arguments of ``mdms run``.
        asked: Options of this benchmark.
        draw: Of the instants.
        whole: Summary of the uninterrupted run.

    Attributes:
        count: Kills by phase and by the run's state after them.
    """

    def __init__(
        self,
        scene: tuple[Any, ...],
        asked: argparse.Namespace,
        draw: np.random.Generator,
        whole: dict[str, Any],
    ) -> None:
        self._scene, self._asked, self._draw, self._whole = scene, asked, draw, whole
        self._start_s = self._end_s = 1.0
        self.count: Counter[tuple[str, str]] = Counter()

    def one(self, most: int) -> int:
        """One run from its start to its end; returns how often it was killed, at most so often."""
        before = self.count.total()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            phases = (self._at_start, self._at_resume, self._at_checkpoint, self._at_end)
            for phase in phases[:most]:
                if not _is_over(folder):
                    phase(folder)
            if not _is_over(folder):
                _check(ended(start(folder, "--resume", folder)), self._whole, folder)
        return self.count.total() - before

    def _at_start(self, folder: Path) -> None:
        """Kill a new run; where that had no checkpoint yet, see that it is refused, and begin it anew up to one."""
        run = self._begun(folder)
        time.sleep(self._draw.uniform(0.0, 1.5 * self._start_s))
        if not kill(run):
            return
        if reached(folder):
            self._tell("the start", "resumable")
            return
        refused = refusal(folder)
        assert "there is no checkpoint" in refused, refused
        self._tell("the start", "refused in a line, without a checkpoint")
        begun, run = time.monotonic(), self._begun(folder)
        _wait(run, (folder / CHECKPOINT).exists)
        self._start_s = time.monotonic() - begun
        kill(run)

    def _at_resume(self, folder: Path) -> None:
        """Kill a resumed run while it starts."""
        last, run = reached(folder), start(folder, "--resume", folder, "--realtime", SLOWLY)
        time.sleep(self._draw.uniform(0.0, 1.5 * self._start_s))
        self._killed(run, folder, "the start of a resumed run", last)

    def _at_checkpoint(self, folder: Path) -> None:
        """Kill a run as soon as it is seen to write a checkpoint."""
        draft, last = folder / DRAFT, reached(folder)
        run = start(folder, "--resume", folder, "--realtime", SLOWLY)
        _wait(run, lambda: draft.exists() or reached(folder) > last)
        self._killed(run, folder, "a checkpoint", last)

    def _at_end(self, folder: Path) -> None:
        """Kill a resumed run about its end, as late as the one before took from its first tick on."""
        last, recording = reached(folder), folder / "recording.mcap"
        before = recording.stat().st_ino
        run = start(folder, "--resume", folder)
        _wait(run, lambda: recording.stat().st_ino != before)
        begun = time.monotonic()
        time.sleep(self._draw.uniform(0.0, self._end_s))
        self._killed(run, folder, "the end", last)
        if _is_over(folder):
            self._end_s = 0.9 * (time.monotonic() - begun)
        else:
            self._end_s *= 1.2

    def _begun(self, folder: Path) -> Mdms:
        options = ("--realtime", SLOWLY, "--checkpoint", self._asked.checkpoint, "--output", folder)
        return start(folder, *self._scene, *options)

    def _killed(self, run: Mdms, folder: Path, phase: str, last: int) -> None:
        """Kill a resumed run: its checkpoint is still there, or the run is over."""
        killed = kill(run)
        if not killed:
            assert _is_over(folder), "it ended otherwise than by the kill"
            return
        if _is_over(folder):
            assert "the run is over, with status ok" in refusal(folder)
            _check(json.loads((folder / "summary.json").read_text()), self._whole, folder)
            self._tell(phase, "over, with its summary")
        else:
            assert reached(folder) >= last > 0, "its checkpoint is lost"
            self._tell(phase, "resumable")

    def _tell(self, phase: str, became: str) -> None:
        self.count[phase, became] += 1
        print(f"{self.count.total()}: killed at {phase}: {became}", flush=True)


def _is_over(folder: Path) -> bool:
    """Whether the run in a folder came to its end."""
    try:
        return json.loads((folder / "summary.json").read_text())["status"] == "ok"
    except FileNotFoundError:
        return False


def _wait(run: Mdms, until: Callable[[], bool]) -> None:
    """Wait until something is so, or the run is over."""
    deadline = time.monotonic() + PATIENCE_S
    while not until() and run.process.poll() is None:
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.001)


def _check(summary: dict[str, Any], whole: dict[str, Any], folder: Path) -> None:
    """Hold a run that is over against the uninterrupted one."""
    assert summary["digest"] == whole["digest"], f"{summary['digest']}: not {whole['digest']}"
    assert summary["messages"] == whole["messages"], f"{summary['messages']}: not {whole['messages']}"
    assert_whole(folder, whole["ticks"], whole["digest"])


if __name__ == "__main__":
    sys.exit(main())
