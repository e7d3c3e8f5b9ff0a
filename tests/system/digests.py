"""Prints the digest of each scene named, run in this process: ``python -m tests.system.digests SCENE ...``."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

DURATION_S = 0.15


def main() -> None:
    found: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:]:
            scene = load_scene(name, [Override(("duration_s",), DURATION_S, "--duration")])
            options = RunOptions(0, "memory", output=Path(folder) / name, picture=False)
            found[name] = run(scene, options, quiet=True).summary.digest
    print(json.dumps(found))


if __name__ == "__main__":
    main()
