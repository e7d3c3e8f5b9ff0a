"""``mdms schema``: JSON Schema of scene files, for editors and other programs."""

from __future__ import annotations

import json

from deploy.scenes.schema import scene_schema


def schema() -> None:
    """Print the JSON Schema of a scene file.

    It knows the parameters of the bundled firmware. Editors check and complete TOML with it; with Taplo or
    Even Better TOML a scene says so in its first line:

      [cyan]#:schema ./scene.schema.json[/cyan]
    """
    print(json.dumps(scene_schema(), indent=2))
