"""``mdms simulate``: the plant alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deploy.commands.options import SceneOptions, StepOption, expand_dataclass
from deploy.commands.outcome import execute

if TYPE_CHECKING:
    from deploy.runs.summary import Outcome
    from deploy.util.signals import Interruption


@expand_dataclass
def simulate(scene_options: SceneOptions, *, step: StepOption = None) -> None:
    """Simulate a scene without cells: wheel speeds straight from its velocity field.

    This is the simulator of the papers: ideal wheels run at the field's speed from the start. The scene's firmware
    must be velocity_field. Writes recording.mcap, summary.json and overview.png to the output folder.

    At a fine tolerance; with the papers' own loop; with SciPy:

      [cyan]mdms simulate elliptic --tolerance 1e-12[/cyan]
      [cyan]mdms simulate elliptic --solver fixed_step --step 1e-3[/cyan]
      [cyan]mdms simulate elliptic --solver scipy --set solver.method=LSODA[/cyan]
    """
    scene = scene_options.load(step=step)

    def work(interruption: Interruption) -> Outcome:
        from deploy.runs.field_simulation import simulate as simulate_scene

        return simulate_scene(
            scene,
            output=scene_options.output,
            picture=scene_options.picture,
            quiet=scene_options.quiet,
            interruption=interruption,
        )

    execute("the simulation", work, as_json=scene_options.as_json)
