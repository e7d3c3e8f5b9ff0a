"""``mdms check``: searches for the schedule of faults that breaks a protocol."""

from __future__ import annotations

import json
import re
import sys
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from deploy.commands.options import JsonOption, QuietOption
from deploy.errors import InputError
from deploy.util.formatting import plural, say, silent

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.adversary.check import Counterexample
    from deploy.studies.adversary.sample import SampleResult
    from deploy.studies.adversary.search import SearchResult
    from deploy.studies.adversary.spec import Adversary

_POWERS, _LIMITS = "Adversary", "Limits"
_WORLD: Final = re.compile(r"([1-9]\d*)x([1-9]\d*)")
_AT_MOST: Final = re.compile(r"([a-z]+)=(\d+)")

ProtocolArgument = Annotated[
    str,
    typer.Argument(
        metavar="PROTOCOL",
        help="Program of the cells: a bundled name, a .py file, or package.module:Class; it defines "
        "invariants(view) or eventually(view).",
    ),
]
WorldOption = Annotated[
    list[str] | None,
    typer.Option(
        "--world", metavar="RxC", help="Rows and columns of a world, repeatable. Default: 1x2 and 2x2."
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="A parameter of the program, the value in TOML; repeatable."
    ),
]
CoverOption = Annotated[
    list[str] | None,
    typer.Option(
        "--cover", metavar="ROW,COLUMN", help="A cell that is covered by a parcel all the time; repeatable."
    ),
]
BeginOption = Annotated[
    list[str] | None,
    typer.Option(
        "--begin",
        metavar="REGISTER=VALUE",
        help="A variable of the program that begins with this value in every cell, such as a counter near its wrap; "
        "repeatable.",
    ),
]
FaultsOption = Annotated[
    int, typer.Option("--faults", rich_help_panel=_POWERS, metavar="N", help="Most faults in all.")
]
KindsOption = Annotated[
    str,
    typer.Option(
        "--kinds", rich_help_panel=_POWERS, metavar="K,K", help="Kinds: loss, delay, death, repair, outage."
    ),
]
AtMostOption = Annotated[
    list[str] | None,
    typer.Option(
        "--at-most", rich_help_panel=_POWERS, metavar="KIND=N", help="Most faults of a kind; repeatable."
    ),
]
DepthOption = Annotated[
    int,
    typer.Option(
        "--depth", rich_help_panel=_POWERS, metavar="TICKS", help="Ticks in which faults may begin."
    ),
]
DelayOption = Annotated[
    list[int] | None,
    typer.Option(
        "--delay",
        rich_help_panel=_POWERS,
        metavar="TICKS",
        help="Delay of a message; repeatable. Default: 1.",
    ),
]
OutageOption = Annotated[
    list[int] | None,
    typer.Option(
        "--outage",
        rich_help_panel=_POWERS,
        metavar="TICKS",
        help="Length of an outage of one direction of a link; repeatable. Default: 4.",
    ),
]
SampleOption = Annotated[
    int | None,
    typer.Option(
        "--sample",
        rich_help_panel=_LIMITS,
        metavar="N",
        min=1,
        help="Follow N random schedules of faults instead of all, for larger worlds; a counterexample is shrunk. Needs "
        "the library Hypothesis.",
    ),
]
SeedOption = Annotated[
    int, typer.Option("--seed", rich_help_panel=_LIMITS, min=0, help="Seed of random schedules.")
]
SymmetryOption = Annotated[
    bool,
    typer.Option(
        "--symmetry/--no-symmetry", rich_help_panel=_LIMITS, help="Merge mirrored and turned states."
    ),
]
StatesOption = Annotated[
    int, typer.Option("--states", rich_help_panel=_LIMITS, metavar="N", min=1, help="Most states of a world.")
]
LimitOption = Annotated[
    float,
    typer.Option("--limit", rich_help_panel=_LIMITS, metavar="SECONDS", help="Most wall time of a world."),
]
OutputOption = Annotated[
    Path,
    typer.Option(
        "--output", metavar="FILE", help="Scene file of a counterexample, which mdms run --check repeats."
    ),
]


ChartOption = Annotated[
    bool,
    typer.Option(
        "--picture/--no-picture",
        help="Draw the messages of a counterexample's last ticks beside it, as a sequence chart.",
    ),
]


def check(
    protocol: ProtocolArgument,
    *,
    world: WorldOption = None,
    sets: SetOption = None,
    cover: CoverOption = None,
    begin: BeginOption = None,
    faults: FaultsOption = 1,
    kinds: KindsOption = "loss,delay,death,repair",
    at_most: AtMostOption = None,
    depth: DepthOption = 12,
    delay: DelayOption = None,
    outage: OutageOption = None,
    sample: SampleOption = None,
    seed: SeedOption = 0,
    symmetry: SymmetryOption = True,
    states: StatesOption = 2_000_000,
    limit: LimitOption = 120.0,
    output: OutputOption = Path("counterexample.toml"),
    picture: ChartOption = True,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Search for faults that break a condition of a protocol: all schedules in small worlds, each state once.

    A world has ideal links, no parcels and no plant. A loss, a delay or an outage of a link's direction, a death and a
    repair of a cell count as one fault each. Every state that at most --faults faults in the first --depth ticks lead
    to is visited. For eventual conditions further ticks without faults follow, until they are due.

    A violation is replayed before it is reported, and written as a scene, with a chart of its last messages. Exit
    status 1: a violation was found.

      [cyan]mdms check tree.py --world 2x2 --faults 2 --depth 12[/cyan]
      [cyan]mdms check words.py --begin version=65534 --kinds loss,outage --outage 5[/cyan]
      [cyan]mdms check tree.py --world 4x6 --faults 5 --depth 40 --sample 1000[/cyan]
      [cyan]mdms run counterexample.toml --check[/cyan]
    """
    from deploy.studies.adversary.check import (
        check_by_sampling,
        check_exhaustively,
        counters_near_wraps,
        world_scene,
    )

    notify = silent if quiet else say
    if not output.parent.is_dir():  # a search may take minutes
        raise InputError(f"--output {output}: there is no folder {output.parent}")
    adversary = _adversary(faults, depth, kinds, delay, outage, at_most)
    covered = [_cell(text) for text in cover or ()]
    rows: list[dict[str, Any]] = []
    counterexample: Counterexample | None = None
    begun, wraps = _table(begin, "--begin"), counters_near_wraps(protocol)
    starts = [begun, *([{**wraps, **begun}] if wraps.keys() - begun.keys() else [])]
    for text, registers in product(world or ("1x2", "2x2"), starts):
        scene = world_scene(
            protocol,
            _size(text),
            parameters=_table(sets, "--set"),
            initial_registers=registers,
            seed=seed,
        )
        _check_covered(covered, scene, text)
        if sample is not None:
            result, counterexample = check_by_sampling(scene, adversary, sample, covered, limit_s=limit)
        else:
            result, counterexample = check_exhaustively(
                scene, adversary, covered, symmetric=symmetry, most_states=states, limit_s=limit
            )
        rows.append({"world": text, "begin": registers, **result.as_json()})
        if not as_json:
            print(coverage(_named(text, registers), adversary, result))
        if counterexample is not None:
            break
    if counterexample is not None:
        counterexample.write(output)
        notify(f"counterexample: {output}; mdms run {output} --check repeats it")
        if picture:
            from deploy.studies.adversary.chart import draw_counterexample

            chart = output.with_suffix(".png")
            if draw_counterexample(counterexample, output, chart):
                notify(f"its messages: {chart}")
    _finish(rows, counterexample, as_json=as_json)


def coverage(world: str, adversary: Adversary, result: SearchResult | SampleResult) -> str:
    """Return what a search has covered, and what was cut off, in a line."""
    from deploy.studies.adversary.search import SearchResult

    powers = f"at most {plural(adversary.faults, 'fault')} ({', '.join(adversary.kinds)})"
    if not isinstance(result, SearchResult):
        what = (
            f"{world}: {plural(result.schedules, 'random schedule')} of up to {plural(result.ticks, 'tick')}"
        )
        cut = f", ended by {result.limit}" if result.limit else ""
        found = "no violation" if result.violation is None else f"BROKEN: {result.violation}"
        return f"{what}{cut}; {powers}: {found}"
    merged = f", {result.symmetries} symmetries merged" if result.symmetries > 1 else ""
    what = f"{world}: {plural(result.states, 'state')}{merged}, {plural(result.ticks, 'tick')} deep"
    if result.tail_ticks:
        what += f" and {result.tail_ticks} without new faults"
    if result.violation is not None:
        return f"{what}; {powers}: BROKEN: {result.violation}"
    if result.limit:
        return (
            f"{what}; {powers}: no violation so far; cut off by {result.limit}: {result.unexplored:,} states were not "
            "followed"
        )
    return f"{what}; {powers}: no violation, nothing cut off"


def _named(world: str, registers: dict[str, Any]) -> str:
    begins = ", ".join(f"{name}={value}" for name, value in registers.items())
    return f"{world} from {begins}" if begins else world


def _finish(rows: list[dict[str, Any]], counterexample: Counterexample | None, *, as_json: bool) -> None:
    violation = None if counterexample is None else str(counterexample.violation)
    status = "ok" if counterexample is None else "failed"
    if as_json:
        print(json.dumps({"status": status, "violation": violation, "worlds": rows}))
    sys.stdout.flush()
    if violation is not None:
        sys.stderr.write(f"mdms: failed: {violation}\n")
        raise typer.Exit(1)


def _adversary(
    faults: int,
    depth: int,
    kinds: str,
    delay: list[int] | None,
    outage: list[int] | None,
    at_most: list[str] | None,
) -> Adversary:
    from deploy.studies.adversary.spec import Adversary

    most: dict[str, int] = {}
    for text in at_most or ():
        match = _AT_MOST.fullmatch(text)
        if match is None:
            raise InputError(f"--at-most {text}: must be KIND=N, such as death=1")
        most[match[1]] = int(match[2])
    named: Any = tuple(one.strip() for one in kinds.split(","))
    return Adversary(faults, depth, named, tuple(delay or (1,)), tuple(outage or (4,)), most)


def _size(text: str) -> tuple[int, int]:
    match = _WORLD.fullmatch(text)
    if match is None:
        raise InputError(f"--world {text}: must be ROWSxCOLUMNS, such as 2x2")
    return int(match[1]), int(match[2])


def _cell(text: str) -> tuple[int, int]:
    row, comma, column = text.partition(",")
    if not (comma and row.isdigit() and column.isdigit()):
        raise InputError(f"--cover {text}: must be ROW,COLUMN")
    return int(row), int(column)


def _check_covered(covered: list[tuple[int, int]], scene: Scene, world: str) -> None:
    lattice = scene.lattice()
    for cell in covered:
        if cell not in lattice:
            raise InputError(f"--cover {cell[0]},{cell[1]}: the world {world} has no such cell")


def _table(texts: list[str] | None, option: str) -> dict[str, Any]:
    """Return the values of ``KEY=VALUE`` options, dots in keys as tables."""
    from deploy.scenes.overrides import Override, apply

    table: dict[str, Any] = {}
    apply(table, [Override.parse(text, f"{option} {text}") for text in texts or ()])
    return table
