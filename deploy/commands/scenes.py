"""``mdms scenes``: list and print bundled scenes."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from deploy.commands.options import JsonOption
from deploy.scenes.files import bundled_names, load_scene, scene_text
from deploy.util.encodings import print_utf8


def scenes(
    scene: Annotated[
        str | None, typer.Argument(metavar="SCENE", help="Scene to print: a bundled name, or a file.")
    ] = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """List the bundled scenes, or print a scene.

    The printed text is a scene file: [cyan]mdms scenes elliptic > mine.toml[/cyan] starts a scene of your own.
    With --json a scene is printed as validated, including defaults.
    """
    if scene is None:
        _list(as_json=as_json)
    elif as_json:
        print(json.dumps(load_scene(scene).model_dump(mode="json"), indent=2))
    else:
        print_utf8(scene_text(scene))


def _list(*, as_json: bool) -> None:
    found = [load_scene(name) for name in bundled_names()]
    if as_json:
        rows = [
            {
                "name": scene.name,
                "title": scene.title,
                "duration_s": scene.duration_s,
                "cells": len(scene.lattice()),
                "parcels": scene.parcel_count,
                "firmware": scene.cells.firmware,
            }
            for scene in found
        ]
        print(json.dumps({"scenes": rows}, indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("scene", style="cyan", no_wrap=True)
    table.add_column("title")
    for heading in ("cells", "parcels", "s"):
        table.add_column(heading, justify="right")
    for scene in found:
        numbers = (str(len(scene.lattice())), str(scene.parcel_count), f"{scene.duration_s:g}")
        table.add_row(scene.name, scene.title, *numbers)
    Console().print(table)
