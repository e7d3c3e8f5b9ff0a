"""Fuzzes one decoder guided by coverage, with atheris: ``python -m tests.fuzz.guided DECODER SECONDS SEED FOLDER``.

The folder is for frames worth keeping, valid ones first.

Ends with status 0 when the time is up, and with atheris's report and another status at the first escape.
"""

from __future__ import annotations

import sys
from pathlib import Path


def main(name: str, seconds: int, seed: int, folder: Path) -> None:
    """Never returns: atheris ends the process."""
    import atheris  # pyright: ignore[reportMissingImports]

    # What is imported here is watched by atheris; what follows finds it there.
    with atheris.instrument_imports(include=["bus", "deploy.control"]):
        from bus.errors import WireError
        from tests.fuzz.targets import targets

    target = next(one for one in targets() if one.name == name)

    def once(data: bytes) -> None:
        try:
            _, value = target.decode(data)
        except WireError:
            return
        target.check(value)

    for i, frame in enumerate(target.frames):
        (folder / str(i)).write_bytes(frame)
    options = [f"-max_total_time={seconds}", f"-seed={seed}", "-max_len=8192", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *options, str(folder)], once)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
