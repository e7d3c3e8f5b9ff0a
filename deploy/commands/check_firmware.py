"""``mdms check-firmware``: what makes a program depend on how it is run."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deploy.commands.options import JsonOption
from deploy.errors import InputError

if TYPE_CHECKING:
    from bus.lattice import Lattice
    from cell_firmware.specs import CellsSpec

_MOST_CELLS = 400


def check_firmware(
    program: Annotated[
        str,
        typer.Argument(
            metavar="PROGRAM",
            help="A bundled name, a .py file, with or without :Class, or package.module:Class.",
        ),
    ],
    *,
    against: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            metavar="PROGRAM",
            help="Another form of the program, which must do the same. Repeatable.",
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option("--scene", metavar="SCENE", help="Scene whose array, period and parameters are used."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A parameter of the program, in TOML. Repeatable."),
    ] = None,
    size: Annotated[
        str, typer.Option("--size", metavar="ROWSxCOLUMNS", help="Rectangle of cells, without --scene.")
    ] = "4x5",
    ticks: Annotated[int, typer.Option("--ticks", min=2, help="Ticks of a trial.")] = 60,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of readings and lost messages.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Check what makes a program depend on how it is run; print a verdict for each check.

    The program's cells are stepped in lockstep, without plant and bus, under random sensor bits; one message in ten is
    lost. The checks: runs (no failure); repeats (the same twice, and in another process); one and many (the same alone
    and among many); forms (the same as --against, and compiled as in Python); arguments (inputs and state are neither
    changed nor kept); message ranges (within value_ranges); purity (no clock, no generator, no global state).

    A check that fails names tick, cell and values. Exit status: 0 if none fails, 1 if one fails, 2 for bad input.

      [cyan]mdms check-firmware conveyor.py --against fast_conveyor.py[/cyan]
      [cyan]mdms check-firmware heat_diffusion --set diffusion_number=0.3 --size 3x3[/cyan]
      [cyan]mdms check-firmware route --scene junction --json[/cyan]
    """
    from deploy.studies.firmware.checks import FirmwareCheck

    spec, lattice = _asked(program, scene, sets or [], size)
    others = {name: spec.model_copy(update={"firmware": _placed(name)}) for name in against or []}
    check = FirmwareCheck(spec, others, lattice, ticks, seed)
    found: list[dict[str, Any]] = []
    if not as_json:
        print(f"{program}: {check.firmware.form}, {len(lattice)} cells, {ticks} ticks, seed {seed}")
    for verdict in check.verdicts():
        found.append(asdict(verdict))
        if not as_json:
            print(f"{verdict.verdict:<8} {verdict.check:<15} {verdict.detail}")
    failed = any(one["verdict"] == "failed" for one in found)
    if as_json:
        print(json.dumps({"program": program, "ok": not failed, "checks": found}, indent=2))
    raise typer.Exit(1 if failed else 0)


def _asked(program: str, scene: str | None, sets: list[str], size: str) -> tuple[CellsSpec, Lattice]:
    """Return settings of the cells, and the cells.

    Raises:
        InputError: An option is none.
    """
    from bus.lattice import Lattice
    from cell_firmware.specs import CellsSpec
    from deploy.scenes.overrides import Override

    if scene is not None:
        from deploy.scenes.files import load_scene

        changes = [Override.parse(f"cells.parameters.{text}", f"--set {text}") for text in sets]
        loaded = load_scene(scene, [Override(("cells", "firmware"), _placed(program), "PROGRAM"), *changes])
        lattice = loaded.lattice()
        spec = loaded.cells
    else:
        rows, _, columns = size.partition("x")
        if not (rows.isdecimal() and columns.isdecimal() and int(rows) * int(columns) > 0):
            raise InputError(f"--size {size}: must be ROWSxCOLUMNS, as 4x5")
        lattice = Lattice((row, column) for row in range(int(rows)) for column in range(int(columns)))
        parameters: dict[str, Any] = {}
        for text in sets:
            change = Override.parse(text)
            inner = parameters
            for key in change.path[:-1]:
                inner = inner.setdefault(str(key), {})
            inner[str(change.path[-1])] = change.value
        spec = CellsSpec(firmware=_placed(program), parameters=parameters)
    if len(lattice) > _MOST_CELLS:
        raise InputError(
            f"{len(lattice)} cells: every cell is also stepped alone; at most {_MOST_CELLS} are checked"
        )
    return spec, lattice


def _placed(program: str) -> str:
    """Return a program's name, with the whole path of a file."""
    path, colon, name = program.partition(":")
    return f"{Path(path).resolve()}{colon}{name}" if path.endswith(".py") else program
