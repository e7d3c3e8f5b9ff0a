"""``mdms schema``: JSON Schema of scene files, for editors and other programs."""

from __future__ import annotations

import json

from deploy.scenes.schema import scene_schema


def schema() -> None:
    """Print the JSON Schema of a scene file.

    The schema includes the parameters of the bundled firmware. Editors check and complete TOML by a schema; with
    Taplo or Even Better TOML the first line of a scene names it:

      [cyan]#:schema ./scene.schema.json[/cyan]
    """
    print(json.dumps(scene_schema(), indent=2))
