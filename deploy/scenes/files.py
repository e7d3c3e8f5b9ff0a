"""Scene files: bundled and user scenes, loading, overrides, and error reports."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cell_firmware.board_presets import expand_preset
from cell_firmware.specs import CellsSpec
from deploy.errors import InputError
from deploy.faults.registry import Fault
from deploy.scenes.checks import cross_problems
from deploy.scenes.effects import EffectsSpec
from deploy.scenes.errors import CROSS, Problem, SceneError, nearest, problems_of, strictly, strictly_any
from deploy.scenes.overrides import Override, apply
from deploy.scenes.scene import Scene
from plant.friction.registry import FrictionSpec
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.solver_specs import SolverSpec, settings_of


def bundled_names() -> tuple[str, ...]:
    """The scenes that come with the package, sorted."""
    folder = resources.files("deploy") / "scenes"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def scene_text(scene: str) -> str:
    """The TOML of a bundled scene, or of a file.

    A bundled name wins over a file of that name; ``./NAME`` means the file.

    Raises:
        InputError: There is no such scene, or it cannot be read.
    """
    if scene in bundled_names():
        return (resources.files("deploy") / "scenes" / f"{scene}.toml").read_text(encoding="utf-8")
    path = Path(scene)
    if not path.exists() and path.suffix != ".toml" and len(path.parts) == 1:
        advice = nearest(scene, bundled_names())
        raise InputError(
            f"scene {scene}: neither a bundled scene nor a file; {advice} (`mdms scenes` lists them)"
        )
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a byte order mark
    except OSError as error:
        raise InputError(f"scene {scene}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"scene {scene}: must be UTF-8 text; byte {error.start} is not") from None


def load_scene(scene: str | Path | Mapping[str, Any], overrides: Sequence[Override | str] = ()) -> Scene:
    """Read, override and validate a scene.

    Args:
        scene: A bundled name, a file, or the tables of a scene file as a dict, in which ``cells.firmware`` may be a
            class or a function too: see `cell_firmware.loader.name_of`.
        overrides: Applied in order, before anything is validated; text is ``KEY=VALUE``, as ``--set`` takes it.

    Raises:
        InputError: There is no such scene, it is no TOML, or an override is no ``KEY=VALUE``.
        SceneError: It is refused; all that is wrong with it, one line each.
    """
    texts = [overrides] if isinstance(overrides, str) else overrides
    changes = [Override.parse(one) if isinstance(one, str) else one for one in texts]
    if isinstance(scene, Mapping):
        return _validated(_with_names(scene), "(a dictionary)", changes)
    if not isinstance(scene, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance] - users aren't type-checked
        raise InputError(f"scene {scene!r}: must be a bundled name, a path, or a dict of a scene's tables")
    name = str(scene)
    text = scene_text(name)
    folder = None if name in bundled_names() else Path(name).parent
    return parse_scene(text, name, changes, folder)


def parse_scene(
    text: str, name: str, overrides: Sequence[Override] = (), folder: Path | None = None
) -> Scene:
    """Validate the text of a scene.

    Args:
        text: TOML.
        name: What errors and results call it.
        overrides: Applied in order, before anything is validated.
        folder: Where the file's own relative paths start; default: the working directory, as for ``--set``.

    Raises:
        InputError: It is no TOML.
        SceneError: It is refused; all that is wrong with it, one line each.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"scene {name}: not TOML: {error}") from None
    if folder is not None:
        _resolve_firmware(data, folder)
    return _validated(data, name, overrides)


def _with_names(scene: Mapping[str, Any]) -> dict[str, Any]:
    """Copy the tables of a scene: a firmware's name in place of the object, plain numbers in place of NumPy's."""
    data = dict(scene)
    if isinstance(data.get("cells"), dict) and not isinstance(data["cells"].get("firmware", ""), str):
        from cell_firmware.loader import name_of

        data["cells"] = {**data["cells"], "firmware": name_of(data["cells"]["firmware"])}
    return {key: _plain(value) for key, value in data.items()}


def _plain(value: Any) -> Any:
    """Copy a value of a scene, with Python's numbers and lists in place of NumPy's."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in cast("dict[Any, Any]", value).items()}
    if isinstance(value, list | tuple):
        inner = [_plain(each) for each in cast("Sequence[Any]", value)]
        return inner if isinstance(value, list) else tuple(inner)
    if isinstance(value, np.generic | np.ndarray):
        return cast("Any", value).tolist()
    return copy.deepcopy(value)


def _validated(data: dict[str, Any], name: str, overrides: Sequence[Override]) -> Scene:
    """Override and validate the tables of a scene; see `parse_scene`."""
    _change_solver(data, overrides)
    apply(data, overrides)
    data = expand_preset(data)
    try:
        return strictly(Scene, data).named(name)
    except ValidationError as error:
        problems = problems_of(error, data, Scene)
        if any(detail["type"] != CROSS for detail in error.errors()):
            problems += _cross_problems(data)
        raise SceneError(name, [_blame(problem, overrides) for problem in problems]) from None


def _resolve_firmware(data: dict[str, Any], folder: Path) -> None:
    """A firmware's file is searched beside its scene."""
    cells: Any = data.get("cells")
    firmware: Any = cast("dict[str, Any]", cells).get("firmware") if isinstance(cells, dict) else None
    if isinstance(firmware, str) and firmware.partition(":")[0].endswith(".py"):
        cells["firmware"] = str(folder.resolve() / firmware)


def _change_solver(data: dict[str, Any], overrides: Sequence[Override]) -> None:
    """Replace the file's solver; settings that only the previous solver has are dropped."""
    table: Any = data.get("solver")
    chosen = [override.value for override in overrides if override.path == ("solver", "name")]
    if not chosen or not isinstance(table, dict):
        return
    own = cast("dict[str, Any]", table)
    wanted = settings_of(chosen[-1])
    if wanted:
        for key in settings_of(own.get("name", "exact")) - wanted:
            own.pop(key, None)


def _cross_problems(data: dict[str, Any]) -> list[Problem]:
    """Find disagreements between sections that are valid by themselves."""
    return cross_problems(
        _part(ArraySpec, data.get("array")),
        _part(CellsSpec, data.get("cells", {})),
        _part(FrictionSpec, data.get("friction")),
        _part(EffectsSpec, data.get("effects", {})),
        _part(SolverSpec, data.get("solver", {})),
        _valid(Fault, data.get("faults")),
        _valid(ParcelSpec, data.get("parcels")),
    )


def _valid(model: Any, data: Any) -> dict[int, Any]:
    """The items of a list that are valid by themselves, by their number."""
    listed = cast("list[Any]", data) if isinstance(data, list) else []
    parts = {number: _part(model, item) for number, item in enumerate(listed)}
    return {number: part for number, part in parts.items() if part is not None}


def _part(model: Any, data: Any) -> Any:
    """A section that is valid by itself, or None; ``model`` may be a union of models."""
    try:
        return strictly_any(TypeAdapter(model), data)
    except ValidationError:
        return None  # reported with its path by the validation of the whole


def _blame(problem: Problem, overrides: Sequence[Override]) -> Problem:
    """Attribute a problem to the option that set the value, a part of the value, or a containing table."""
    for override in reversed(overrides):
        shared = min(len(problem.path), len(override.path))
        if shared and problem.path[:shared] == override.path[:shared]:
            return replace(problem, option=override.option)
    return problem
