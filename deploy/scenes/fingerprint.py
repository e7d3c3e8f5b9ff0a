"""Fingerprint of a run: everything that determines its bits, by name."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from hashlib import sha256
from inspect import getsourcefile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from bus import elementary
from deploy.util.files import versions

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

_OF_CELLS: Final = ("mdms-emulator", "python", "machine", "numpy", "numba", "llvmlite")
"""Versions that decide the bits of a process of cells; those of other libraries may differ between hosts."""
_LISTED: Final = 3
"""Values of a scene that a line lists."""
_LONGEST: Final = 40
"""Characters of a value that people are shown."""
_SHORT: Final = 12
"""Characters of a hash that people are shown."""


def fingerprint(scene: Scene) -> dict[str, str]:
    """Return everything that determines the bits of a run, by name."""
    from plant.kernels.common.cache import key

    return {
        **versions(),
        "elementary functions": elementary.fingerprint(),
        "the plant's kernels": key(),
        "the scene": sha256(scene.canonical()).hexdigest(),
        "the cells' program": program_fingerprint(scene),
    }


def cells_fingerprint(scene: Scene) -> dict[str, str]:
    """Return everything that determines the bits of a process of cells, by name.

    The scene's part doesn't cover limits on the wall clock, such as ``stall.start_s``: these may differ.
    """
    from bus.kernel_cache.processor import level

    found = versions()
    found["python"] = found["python"].rpartition(".")[0]  # patches of Python change no arithmetic
    return {
        **{name: found[name] for name in _OF_CELLS},
        "processor level": " ".join(level()).strip(),
        "elementary functions": elementary.fingerprint(),
        "the scene": sha256(scene.canonical()).hexdigest(),
        "the cells' program": program_fingerprint(scene),
    }


def run_fingerprint(scene: Scene) -> dict[str, str]:
    """Return everything that determines the bits of a run whose plant and cells share a host, by name."""
    return {**fingerprint(scene), **cells_fingerprint(scene)}


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> list[str]:
    """Return what differs between two fingerprints, such as ``numpy 2.1.0, not 2.2.0``: first there, then here."""
    return [
        f"{name} {there.get(name, 'unknown')[:_SHORT]}, not {value[:_SHORT]}"
        for name, value in here.items()
        if there.get(name) != value
    ]


def scene_differences(here: bytes, there: bytes) -> list[str]:
    """Return the first values that differ between two canonical scenes, such as ``seed 2, not 1``.

    Args:
        here: ``Scene.canonical()`` of this process.
        there: That of another; may be anything, since it comes from the network.
    """
    try:
        ours, theirs = _leaves(json.loads(here)), _leaves(json.loads(there))
    except (ValueError, RecursionError):
        return []
    names = [name for name in ours | theirs if ours.get(name) != theirs.get(name)]
    listed = [f"{name} {_short(theirs.get(name))}, not {_short(ours.get(name))}" for name in names[:_LISTED]]
    return [*listed, f"and {len(names) - _LISTED} more values"] if len(names) > _LISTED else listed


def _leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Return the plain values of a scene, by dotted path."""
    items: Iterable[tuple[Any, Any]]
    if isinstance(value, dict):
        items = cast("dict[str, Any]", value).items()
    elif isinstance(value, list) and any(isinstance(one, dict | list) for one in cast("list[Any]", value)):
        items = enumerate(cast("list[Any]", value))
    else:
        return {path: value}
    found: dict[str, Any] = {}
    for key, inner in items:
        found |= _leaves(inner, f"{path}.{key}" if path else str(key))
    return found


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def program_fingerprint(scene: Scene) -> str:
    """Return the hash of the file of the cells' program, and of the files beside it that it imports.

    Empty where the program has no file.
    """
    from cell_firmware.cell import PerCellAdapter
    from cell_firmware.firmware_files import modules_beside
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    own = firmware.firmware if isinstance(firmware, PerCellAdapter) else firmware
    path = getsourcefile(type(own))
    if path is None:
        return ""
    text = Path(path).read_bytes()
    beside = {
        module.__name__.partition(".")[2]: Path(module.__file__).read_bytes()
        for module in modules_beside(type(own).__module__)
        if module.__file__ is not None and module.__name__ != type(own).__module__
    }
    parts = [text, *(name.encode() + b"\0" + sha256(beside[name]).digest() for name in sorted(beside))]
    return sha256(b"".join(parts)).hexdigest()
