"""Frames a second of the page of ``mdms view`` over a run in progress, with everything on, on the cores of the run.

``python tests/benchmarks/deploy/view_rate.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT))

from deploy.scenes.files import load_scene  # noqa: E402
from tests.deploy.view.browser import View, Watched, chromium, opened  # noqa: E402

METHOD = """\
Method. mdms view starts the scene in real time and serves the page; headless chromium without a graphics processor
shows it at 1280 x 800 with all layers, a selected cell with its registers, and a plot. A frame counts when the
browser has painted it. Processor time, of a core, is of all processes of each part, in the same seconds."""
LEAST = 5.0
"""Least frames a second, at any size."""
TICK = os.sysconf("SC_CLK_TCK")


def _family() -> dict[int, tuple[int, float]]:
    """Parent and processor time, s, of every process; its ended children's included."""
    found: dict[int, tuple[int, float]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        found[int(path.parent.name)] = int(fields[1]), sum(map(int, fields[11:15])) / TICK
    return found


def _spent(root: int) -> float:
    """Processor time of a process and its descendants, s."""
    family = _family()
    wanted = {root}
    while more := {pid for pid, (parent, _) in family.items() if parent in wanted} - wanted:
        wanted |= more
    return sum(family[pid][1] for pid in wanted if pid in family)


def _own(pid: int) -> float:
    return _family()[pid][1]


def _everything(page: Watched) -> None:
    """Switch everything on."""
    for name in ("arrows", "trails", "messages", "captured", "coming"):
        page.page.check(f"#layer-{name}")
    page.press("w")
    page.page.click("#tab-wheels")
    page.settled()


def measure(scene: str, seconds: float) -> float:
    """Show a run of a scene, print a line, and return the frames a second."""
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        view = View(Path(folder), scene, "--duration", "1000")
        try:
            with opened(browser, view.url) as page:
                page.until("mdms.page.state.tick > 20", 60)
                _everything(page)
                began, first = time.monotonic(), page.state()
                frames = page.page.evaluate("mdms.page.frames")
                spent = _spent(os.getpid()), _spent(view.process.pid), _own(view.process.pid)
                time.sleep(seconds)
                wall, last = time.monotonic() - began, page.state()
                shown = page.page.evaluate("mdms.page.frames") - frames
                everyone, run_and_page, server = (
                    after - before
                    for after, before in zip(
                        (_spent(os.getpid()), _spent(view.process.pid), _own(view.process.pid)),
                        spent,
                        strict=True,
                    )
                )
                cells = len(load_scene(scene).lattice())
                pace = (last["time_s"] - first["time_s"]) / wall
                print(
                    f"{scene:12} {cells:7,} cells  {shown / wall:5.1f} frames/s   run at {pace:.2f} of real time   "
                    f"core: server {server / wall:4.0%}, run {(run_and_page - server) / wall:4.0%}, "
                    f"browser {(everyone - run_and_page) / wall:4.0%}"
                )
                page.page.evaluate("window.mdms.lost = () => {}")
                view.end()
                page.problems.clear()
                return shown / wall
        finally:
            with view.process:
                view.process.kill()


def main() -> None:
    """Measure the page of each scene."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scenes", nargs="*", default=["prototype", "elliptic", "large"], help="scenes to run"
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="wall time of each")
    parser.add_argument(
        "--check", action="store_true", help=f"fail below {LEAST:g} frames a second, which are too few"
    )
    options = parser.parse_args()
    print(METHOD, flush=True)
    slow = [scene for scene in options.scenes if measure(scene, options.seconds) < LEAST]
    if options.check and slow:
        raise SystemExit(f"too few frames a second: {', '.join(slow)}")


if __name__ == "__main__":
    main()
