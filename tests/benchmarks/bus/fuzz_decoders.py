"""Fuzzes every decoder of the bus, and the loader of recordings, and says what became of the frames.

    python tests/benchmarks/bus/fuzz_decoders.py                     # 10^6 spoilt frames into each decoder, seed 1
    python tests/benchmarks/bus/fuzz_decoders.py --frames 20000 --files 500
    python tests/benchmarks/bus/fuzz_decoders.py --frames 0 --files 0 --atheris 30   # guided by coverage, 30 s a
    decoder

Frames are valid ones spoilt by a seeded mutator: the same seed, the same frames. A frame is refused by name, or
accepted, and then has to be what its key promises. Anything else is an escape: it is printed, and the status is 1.
Memory is looked at after 2 %, half and all of the frames: the process's own (resident), what malloc has handed out and
not got back (glibc's count), and the interpreter's blocks, which are those of live objects: a decoder that kept
something would show in the last two. (The interpreter's table of names may grow once, by a megabyte: MessagePack puts
every key that it reads there, and takes it out again.) The peak is the most that one frame of the first 2,000
allocated, by tracemalloc, in a run of its own.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import importlib.util
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT))

from bus.errors import WireError  # noqa: E402 - the tree must be found first
from tests.fuzz.mutator import Mutator  # noqa: E402
from tests.fuzz.recordings import SpoiltMessages, record, use  # noqa: E402
from tests.fuzz.targets import Target, targets  # noqa: E402

_PEAK_FRAMES = 2000
_HEAP = [
    "arena",
    "ordblks",
    "smblks",
    "hblks",
    "hblkhd",
    "usmblks",
    "fsmblks",
    "uordblks",
    "fordblks",
    "keepcost",
]


class Memory(NamedTuple):
    """What the process holds."""

    resident_mb: float
    heap_mb: float
    blocks: int


class Escape(NamedTuple):
    """What should not have happened."""

    decoder: str
    error: str
    payload: str


def _memory() -> Memory:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return Memory(pages * 4096 / 1e6, _heap_bytes() / 1e6, sys.getallocatedblocks())


class _Heap(ctypes.Structure):
    """glibc's ``struct mallinfo2``."""

    _fields_ = tuple((name, ctypes.c_size_t) for name in _HEAP)


def _heap_bytes() -> float:
    """Bytes that malloc has handed out; NaN where the C library does not say."""
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallinfo2"):
        return float("nan")
    libc.mallinfo2.restype = _Heap
    heap = libc.mallinfo2()
    return heap.uordblks + heap.hblkhd


def fuzz(target: Target, frames: int, seed: int) -> list[Escape]:
    """Spoilt frames into one decoder; prints what became of them."""
    mutator = Mutator(target.frames, f"fuzz {target.name} {seed}", target.form)
    refused, accepted, slowest_s, escapes = Counter[str](), 0, 0.0, list[Escape]()
    memory = list[Memory]()
    looks = {max(frames // 50, 1) - 1, frames // 2, frames - 1}
    spent_s = 0.0
    clock, decode = time.perf_counter, target.decode
    for i in range(frames):
        payload = mutator.next()
        begun = clock()
        try:
            _, value = decode(payload)
            took_s = clock() - begun
            target.check(value)
            accepted += 1
        except WireError as error:
            took_s = clock() - begun
            refused[error.reason] += 1
        except Exception as error:  # noqa: BLE001 - an escape is what this looks for
            took_s = clock() - begun
            escapes.append(Escape(target.name, repr(error)[:120], payload[:80].hex()))
        spent_s += took_s
        slowest_s = max(slowest_s, took_s)
        if i in looks:
            memory.append(_memory())
    names = ", ".join(f"{name} {count:,}" for name, count in refused.most_common())
    print(
        f"| {target.name} | {frames:,} | {accepted:,} | {names} | {spent_s / frames * 1e6:.1f} | {slowest_s * 1e3:.1f} "
        f"| {' / '.join(f'{m.resident_mb:.1f}' for m in memory)} "
        f"| {' / '.join(f'{m.heap_mb:.2f}' for m in memory)} | {memory[-1].blocks - memory[0].blocks:+,} "
        f"| {_peak(target, min(frames, _PEAK_FRAMES), seed):,} | {len(escapes)} |",
        flush=True,
    )
    return escapes


def _peak(target: Target, frames: int, seed: int) -> int:
    """The most bytes that one frame allocated while it was read."""
    mutator, most = Mutator(target.frames, f"fuzz {target.name} {seed}", target.form), 0
    tracemalloc.start()
    for _ in range(frames):
        payload = mutator.next()
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        try:
            target.decode(payload)
        except WireError:
            pass
        except Exception:  # noqa: BLE001 - counted elsewhere
            continue
        most = max(most, tracemalloc.get_traced_memory()[1] - before)
    tracemalloc.stop()
    return most


def fuzz_files(files: int, seed: int) -> list[Escape]:
    """Spoilt recordings into the loader: half of them changed or cut as files, half whole with spoilt messages."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        changed = Mutator([record(folder)], f"fuzz file {seed}", None)
        whole = SpoiltMessages(folder, f"fuzz messages {seed}")

        def change() -> Path:
            path = folder / "changed.mcap"
            path.write_bytes(changed.next())
            return path

        escapes = _load_all("file", files // 2, change)
        return escapes + _load_all("messages", files // 2, whole.next)


def _load_all(what: str, files: int, spoil: Callable[[], Path]) -> list[Escape]:
    escapes, loaded, spent_s = list[Escape](), 0, 0.0
    first = _memory()
    for _ in range(files):
        path = spoil()
        begun = time.perf_counter()
        try:
            loaded += use(path) is not None
        except Exception as error:  # noqa: BLE001 - an escape is what this looks for
            escapes.append(Escape(f"recording, {what}", repr(error)[:120], str(path)))
        spent_s += time.perf_counter() - begun
    last = _memory()
    print(
        f"| recording, {what} | {files:,} | {loaded:,} | as bad input {files - loaded - len(escapes):,} "
        f"| {spent_s / max(files, 1) * 1e6:.0f} | | {first.resident_mb:.1f} / {last.resident_mb:.1f} "
        f"| {first.heap_mb:.2f} / {last.heap_mb:.2f} "
        f"| {last.blocks - first.blocks:+,} | | {len(escapes)} |",
        flush=True,
    )
    return escapes


def _chosen(words: str) -> list[Target]:
    return [target for target in targets() if words in target.name]


def guided(chosen: list[Target], seconds: int, seed: int) -> int:
    """Every decoder in a process of its own, guided by coverage; returns how many escapes there were."""
    if importlib.util.find_spec("atheris") is None:
        print("\natheris is not installed (pip install atheris): no run guided by coverage")
        return 0
    print(
        f"\nGuided by coverage, {seconds} s each\n\n| decoder | runs | edges, features | |\n|---|---|---|---|"
    )
    failures = 0
    for target in chosen:
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(
                [sys.executable, "-m", "tests.fuzz.guided", target.name, str(seconds), str(seed), folder],
                cwd=ROOT, capture_output=True, text=True, timeout=seconds * 3 + 120, check=False,
            )  # fmt: skip
        runs, coverage = _stats(done.stderr)
        word = "no escape" if done.returncode == 0 else f"status {done.returncode}"
        print(f"| {target.name} | {runs} | {coverage} | {word} |", flush=True)
        if done.returncode != 0:
            failures += 1
            print(done.stdout[-2000:], done.stderr[-3000:])
    return failures


def _stats(text: str) -> tuple[str, str]:
    """Runs and coverage, from libFuzzer's last words."""
    runs = [
        line.rpartition(":")[2].strip() for line in text.splitlines() if "number_of_executed_units" in line
    ]
    cover = [line for line in text.splitlines() if "cov:" in line]
    last = ", ".join(cover[-1].partition("cov:")[2].partition("corp:")[0].split()[::2]) if cover else ""
    return f"{int(runs[-1]):,}" if runs else "?", last


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000, help="spoilt frames into each decoder")
    parser.add_argument("--files", type=int, default=20_000, help="spoilt recordings")
    parser.add_argument(
        "--atheris", type=int, default=0, metavar="SECONDS", help="guided by coverage, each decoder"
    )
    parser.add_argument("--only", default="", metavar="WORDS", help="decoders whose name has these words")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(
        "| decoder | frames | accepted | refused | µs each | slowest ms | resident MB | malloc MB | blocks "
        "| peak B | escapes |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|", flush=True)
    escapes = list[Escape]()
    if options.frames:
        for target in _chosen(options.only):
            escapes += fuzz(target, options.frames, options.seed)
    if options.files:
        escapes += fuzz_files(options.files, options.seed)
    for escape in escapes[:20]:
        print(f"ESCAPE {escape.decoder}: {escape.error}\n  {escape.payload}")
    failures = guided(_chosen(options.only), options.atheris, options.seed) if options.atheris else 0
    return 1 if escapes or failures else 0


if __name__ == "__main__":
    sys.exit(main())
