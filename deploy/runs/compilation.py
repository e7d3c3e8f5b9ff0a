"""Progress of the compilation of a scene's kernels."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Final

from deploy.scenes.scene import Scene

_LINE_S: Final = 5.0
"""Wall time between two lines of progress."""


def is_segmented(scene: Scene) -> bool:
    """Whether wheels change, or cells read, within a call of the plant."""
    motors = scene.effects.motors
    return scene.effects.clock is not None or (motors is not None and motors.first_order.static_v > 0.0)


@contextmanager
def compilation_reported(solver: str, say: Callable[[str], None]) -> Generator[Callable[[], int]]:
    """Report what is compiled in here: when it begins, and every few seconds.

    Args:
        solver: its name.
        say: called with each line; not at all where everything is loaded.

    Yields:
        A function that returns how many entry points have been compiled so far.
    """
    from plant.kernels.common.compile_events import listening

    functions, begun_s, said_s = 0, 0.0, 0.0
    collecting = gc.isenabled()

    def on_start(name: str, depth: int) -> None:
        nonlocal functions, begun_s, said_s
        now_s = time.perf_counter()
        if functions == 0:
            begun_s = said_s = now_s
            gc.disable()  # nearly all of the compiler's many objects stay: looking through them takes a tenth
            say(f"{_reason()}compiling kernels of {solver} ({_how_often()}) ...")
        functions += 1
        if now_s - said_s > _LINE_S and depth:
            said_s = now_s
            say(f"compiling {solver}: {functions} functions in {now_s - begun_s:.0f} s, now {name}")

    try:
        with listening(on_start) as entries:
            yield entries
    finally:
        if collecting:
            gc.enable()


def _how_often() -> str:
    from plant.kernels.common.cache import folder

    _, lasting = folder()
    return "once" if lasting else "every time: the cache folder can't be written, see NUMBA_CACHE_DIR"


def _reason() -> str:
    """Why kernels that came with a wheel are not used."""
    from plant.kernels.common.cache import mismatch

    other = mismatch()
    return other and f"the compiled kernels of this installation are for {other}; "
