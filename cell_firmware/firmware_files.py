"""Import of firmware files: the modules of a file's folder as a private package.

A firmware file imports what lies beside it as a script does, ``import helper``. Each folder's modules are modules of a
package of its own in ``sys.modules``, so that two folders may have files of the same name.
"""

from __future__ import annotations

import builtins
import importlib
import importlib.util
import sys
from collections.abc import Mapping, Sequence
from hashlib import sha256
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, Final, final

PREFIX: Final = "mdms_firmware_"
"""The package of a folder is named by it and by a hash of the folder's path."""
_OURS: Final = frozenset(("bus", "cell_firmware", "deploy", "mdms", "plant"))
"""Packages that are never searched beside a file: its base classes are from them."""


def import_file(path: Path) -> ModuleType:
    """Import a Python file, again each time, with the modules that lie beside it.

    Args:
        path: The file.

    Raises:
        Exception: Whatever the file raises; none of its folder's modules stays imported then.
    """
    path = path.resolve()
    package = PREFIX + sha256(str(path.parent).encode()).hexdigest()[:16]
    _forget(package)
    importlib.invalidate_caches()
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
    parent = ModuleType(package)
    parent.__path__ = [str(path.parent)]
    sys.modules[package] = parent
    name = f"{package}.{path.stem.replace('.', '_')}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Loader(name, str(path)))
    assert spec is not None, "this is a bug: a loader was given"
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pydantic look their module up while it loads
    try:
        spec.loader.exec_module(module)
    except BaseException:
        _forget(package)
        raise
    return module


def modules_beside(name: str) -> list[ModuleType]:
    """Return the modules imported from a firmware file's folder, by the file's module name; none for other modules."""
    package = name.partition(".")[0]
    if not package.startswith(PREFIX):
        return []
    return [module for key, module in list(sys.modules.items()) if key.startswith(f"{package}.")]


def _forget(package: str) -> None:
    for name in [name for name in sys.modules if name == package or name.startswith(f"{package}.")]:
        del sys.modules[name]


@final
class _Loader(SourceFileLoader):
    """Loader of a module of a folder, whose imports look there first."""

    def exec_module(self, module: ModuleType) -> None:
        package = module.__name__.partition(".")[0]
        vars(module)["__builtins__"] = {**vars(builtins), "__import__": _Importer(package)}
        super().exec_module(module)


@final
class _Finder(MetaPathFinder):
    """Finder of the modules of such packages."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        if path is None or not fullname.startswith(PREFIX):
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(fullname, spec.loader.path)
        return spec


@final
class _Importer:
    """``__import__`` of a folder's modules: a module or package that lies in the folder comes before an installed one.

    Args:
        package: The folder's.
    """

    def __init__(self, package: str) -> None:
        self._package = package

    def __call__(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,  # noqa: A002 - the name that callers may use
        locals: Mapping[str, Any] | None = None,  # noqa: A002
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        top = name.partition(".")[0]
        if level or not self._has(top):
            return builtins.__import__(name, globals, locals, fromlist or (), level)
        found = builtins.__import__(f"{self._package}.{name}", globals, locals, fromlist or (), 0)
        return found if fromlist else sys.modules[f"{self._package}.{top}"]

    def _has(self, top: str) -> bool:
        if top in _OURS or top in sys.builtin_module_names:
            return False
        name = f"{self._package}.{top}"
        if name in sys.modules:
            return True
        parent = sys.modules.get(self._package)
        spec = None if parent is None else PathFinder.find_spec(name, parent.__path__)
        return spec is not None and spec.origin is not None  # a mere folder of data has none
