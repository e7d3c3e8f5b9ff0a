"""Campaign specification, stored in the campaign's folder so that the campaign can be resumed."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, final

from pydantic import Field, ValidationError

from bus.spec import Finite, NotNegative, Positive, Spec
from deploy.errors import InputError
from deploy.scenes.errors import problems_of, strictly
from deploy.util.files import write_text

FILE_NAME = "campaign.toml"
SCENE_NAME = "scene.toml"


@final
class CampaignSpec(Spec):
    """Arguments of ``mdms campaign`` that determine the campaign's runs and their evaluation.

    Strings are stored as they were typed.
    """

    scene: str
    """Bundled name, or the file."""
    folder: str | None = None
    """Where the file's own relative paths start; None for a bundled scene."""
    set: tuple[str, ...] = ()
    duration_s: Finite | None = None
    fault: str | None = None
    share: str | None = None
    vary: tuple[str, ...] = ()
    at_s: NotNegative = 0.0
    until_s: NotNegative | None = None
    seeds: str = "10"
    against: tuple[str, ...] = ()
    within_m: Positive | None = None
    limit_s: Positive = 600.0
    check: bool = False
    confidence: Annotated[float, Field(gt=0, lt=1)] = 0.95


OPTIONS = {
    "scene": "SCENE",
    "duration_s": "--duration",
    "at_s": "--at",
    "until_s": "--until",
    "within_m": "--within",
    "limit_s": "--limit",
}
"""Command line options of fields whose option isn't ``--`` and the field's name."""


def read_options(given: dict[str, Any]) -> CampaignSpec:
    """Validate the command line's options.

    Args:
        given: Values by field; None for options that were not given.

    Raises:
        InputError: A value that is not allowed, one line each.
    """
    data = {name: value for name, value in given.items() if value is not None}
    try:
        return strictly(CampaignSpec, data)
    except ValidationError as error:
        problems = problems_of(error, data, CampaignSpec)
        lines = [f"{_option(str(one.path[0]))} {data[str(one.path[0])]}: {one.rule}" for one in problems]
        raise InputError("\n".join(lines)) from None


def write(
    spec: CampaignSpec, scene: str, versions: Mapping[str, str], programs: Mapping[str, str], folder: Path
) -> None:
    """Write the specification and the scene's text to the campaign's folder.

    Args:
        spec: The specification.
        scene: The text.
        versions: Versions of all that decides a run's bits, by name.
        programs: Fingerprints of the cells' programs, by the name that scenes have for them.
        folder: The campaign's.

    Raises:
        DeployError: It can't be written.
    """
    write_text(folder / SCENE_NAME, scene)
    said = {name: value for name, value in spec.model_dump(mode="json").items() if value is not None}
    lines = ["# What was asked of `mdms campaign`; `mdms campaign --resume` reads it.", ""]
    lines += [f"{name} = {_toml(value)}" for name, value in said.items()]
    lines += ["", "[versions]", *(f"{name} = {_toml(value)}" for name, value in versions.items())]
    lines += ["", "[programs]", *(f"{_toml(name)} = {_toml(value)}" for name, value in programs.items())]
    write_text(folder / FILE_NAME, "\n".join(lines) + "\n")


@final
class Stored(NamedTuple):
    """Files of `write`, as read: its arguments."""

    spec: CampaignSpec
    scene: str
    versions: dict[str, str]
    programs: dict[str, str]


def read(folder: Path) -> Stored:
    """Read the files of `write`.

    Raises:
        InputError: There is no campaign in the folder, or it can't be read.
    """
    try:
        data = tomllib.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
        scene = (folder / SCENE_NAME).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"--resume {folder}: no campaign there: {FILE_NAME} is missing") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"--resume {folder}: {FILE_NAME}: {error}") from None
    versions, programs = data.pop("versions", {}), data.pop("programs", {})
    try:
        return Stored(strictly(CampaignSpec, data), scene, dict(versions), dict(programs))
    except ValidationError as error:
        lines = [f"--resume {folder}: {FILE_NAME}: {one}" for one in problems_of(error, data, CampaignSpec)]
        raise InputError("\n".join(lines)) from None


def check_same(stored: CampaignSpec, given: dict[str, Any], folder: Path) -> None:
    """Refuse to go on with a campaign under other arguments than it was begun with.

    Args:
        stored: What it was begun with.
        given: By field; None where nothing was said.
        folder: The campaign's.

    Raises:
        InputError: Names what differs, one line each.
    """
    data = stored.model_dump()
    lines = [
        f"--resume {folder}: {_option(name)} {_typed(value)}: the campaign has {_typed(data[name])}"
        for name, value in given.items()
        if value is not None and value != data[name]
    ]
    if lines:
        raise InputError("\n".join(lines))


def check_versions(stored: dict[str, str], now: dict[str, str], folder: Path) -> None:
    """Refuse to mix runs of several versions of anything that decides a run's bits.

    Raises:
        InputError: Names what differs.
    """
    names = sorted(stored.keys() | now.keys())
    changed = [
        f"{name} {stored.get(name)}, now {now.get(name)}"
        for name in names
        if stored.get(name) != now.get(name)
    ]
    if changed:
        raise InputError(
            f"--resume {folder}: versions have changed: {'; '.join(changed)}: runs may differ in their last bits; "
            "--other-versions resumes nevertheless"
        )


def check_programs(stored: Mapping[str, str], now: Mapping[str, str], folder: Path) -> None:
    """Refuse to mix runs of different programs under one name; campaigns of before that stored none are not checked.

    Raises:
        InputError: Names the programs whose files have changed.
    """
    changed = [name for name, value in stored.items() if now.get(name, value) != value]
    if changed:
        raise InputError(
            f"--resume {folder}: the program has changed since the campaign began: {', '.join(changed)}: "
            "the table would mix runs of both; begin another campaign, or restore the file"
        )


def _option(name: str) -> str:
    return OPTIONS.get(name, f"--{name}")


def _typed(value: Any) -> str:
    if value is None or value == ():
        return "none"
    return " ".join(value) if isinstance(value, tuple) else str(value)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]


def _toml(value: Any) -> str:
    """A text, a number or a list of texts: JSON's form of them is TOML too, but for one character."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")
