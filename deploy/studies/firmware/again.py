"""A trial in another process, whose strings have other hashes: prints the digest of every tick.

Run by ``checks``: ``python -m deploy.studies.firmware.again`` with a JSON object on stdin.
"""

from __future__ import annotations

import json
import sys
from contextlib import redirect_stdout

from bus.lattice import Lattice
from cell_firmware.loader import load
from cell_firmware.specs import CellsSpec
from deploy.studies.firmware.setting import setting_of
from deploy.studies.firmware.trial import run_trial


def main() -> None:
    """Read the trial, run it, and print its digests as JSON."""
    asked = json.load(sys.stdin)
    with redirect_stdout(sys.stderr):  # what the program prints
        spec = CellsSpec.model_validate(asked["cells"])
        lattice = Lattice((row, column) for row, column in asked["lattice"])
        firmware = load(spec)
        digests = run_trial(
            firmware, setting_of(firmware, spec, lattice, asked["ticks"], asked["seed"])
        ).digests()
    sys.stdout.write(json.dumps(digests))


if __name__ == "__main__":
    main()
