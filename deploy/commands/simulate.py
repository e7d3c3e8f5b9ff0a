"""``mdms simulate``: the plant alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deploy.commands.options import Asked
from deploy.commands.outcome import carry_out
from deploy.commands.spread import spread

if TYPE_CHECKING:
    from deploy.interruption import Interruption
    from deploy.run import Outcome


@spread
def simulate(asked: Asked) -> None:
    """Simulate a scene without cells: wheel speeds straight from its velocity field.

    This is the simulator of the papers: ideal wheels that run at the field's speed from the start. The scene's
    firmware must be velocity_field. Leaves summary.json and overview.png in the output folder.
    """
    scene = asked.load()

    def work(interruption: Interruption) -> Outcome:
        from deploy.simulate import simulate as simulate_scene

        return simulate_scene(
            scene,
            output=asked.output,
            picture=asked.picture,
            quiet=asked.quiet,
            interruption=interruption,
        )

    carry_out("the simulation", work, as_json=asked.as_json)
