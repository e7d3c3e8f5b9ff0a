"""Build hook of wheels: compiles the kernels that the bundled scenes need, and puts them into the wheel.

Such a wheel is for one platform and one minor version of Python. Its kernels fit one version of numba and one level of
processor; elsewhere the first run compiles, as from a checkout. An editable installation has no part in this.

``MDMS_WHEEL_SCENES`` names other scenes, separated by spaces; empty: none, and the wheel is for any platform. Compiled
kernels in ``NUMBA_CACHE_DIR``, if that is set, are not compiled again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SCENES = "MDMS_WHEEL_SCENES"
PACKAGES = ("cell_firmware", "plant")
PLACE = """
import importlib, json, sys
from bus.kernel_cache import cache
importlib.import_module(f"{sys.argv[1]}.kernels")
found = cache.cache_of(f"{sys.argv[1]}.kernels")
print(json.dumps([str(found.folder()[0]), cache.surroundings(), cache.MADE_FOR, found.shipped.name]))
"""


class KernelsHook(BuildHookInterface[Any]):
    """Hook that hatchling calls before it packs a wheel, and after."""

    _folder: tempfile.TemporaryDirectory[str] | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile kernels, and add them to the files of a wheel."""
        scenes = os.environ.get(SCENES)
        if version == "editable" or scenes == "":
            return
        self._folder = tempfile.TemporaryDirectory(prefix="mdms-wheel-")
        kept = os.environ.get("NUMBA_CACHE_DIR") or self._folder.name
        environment = {**os.environ, "NUMBA_CACHE_DIR": kept, "PYTHONPATH": self.root, "MPLBACKEND": "Agg"}

        def python(*arguments: str) -> str:
            command = [sys.executable, *arguments]
            # progress goes to stderr, which the frontend shows
            return subprocess.run(
                command, cwd=self._folder.name, env=environment, check=True, stdout=subprocess.PIPE, text=True
            ).stdout

        python("-m", "deploy.cli", "warm", *(scenes or "").split())
        included: dict[str, str] = {}
        for package in PACKAGES:
            path, surroundings, made_for, shipped = json.loads(python("-c", PLACE, package))
            note = Path(self._folder.name) / f"{package}.json"
            note.write_text(json.dumps(surroundings), encoding="utf-8")
            included[str(note)] = f"{package}/{shipped}/{made_for}"
            for file in sorted(Path(path).rglob("*")):
                if file.suffix in {".nbi", ".nbc"} or file.parent.name == "texts":
                    place = f"{Path(path).name}/{file.relative_to(path).as_posix()}"
                    included[str(file)] = f"{package}/{shipped}/{place}"
        build_data["force_include"].update(included)
        build_data["pure_python"] = False
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"cp{sys.version_info.major}{sys.version_info.minor}-none-{platform}"

    def finalize(self, *_: object) -> None:
        """Remove what the wheel has by now."""
        if self._folder is not None:
            self._folder.cleanup()
