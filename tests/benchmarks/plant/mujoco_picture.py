"""The picture of cost against error, MuJoCo's contacts and the implicit solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from deploy.plots.map_view import INK
from deploy.studies.accuracy.experiments.markdown import panels
from deploy.util.colours import colour


def draw(rows: Sequence[Any]) -> Figure:
    """Error against processor time, log-log: a belt in closed form, and the elliptic field."""
    figure, axes = panels(
        "A parcel under Coulomb friction: cost against error",
        "left: set down on a belt, against the closed form; right: in the elliptic field, against implicit at 1e-9",
        widths_in=(4.6, 4.6),
        height_in=3.5,
    )
    for view, case in zip(axes, (0, -1), strict=True):
        for number, model in enumerate(dict.fromkeys(row.model for row in rows)):
            ours = model.startswith("`")
            own = [row for row in rows if row.model == model and row.errors_m[case] is not None]
            for stepped, style in ((True, "o-"), (False, "s--")):
                some = [row for row in own if ("tolerance" not in row.setting) == stepped]
                if not some:
                    continue
                words = model.strip("`") + (
                    "" if not ours else (", fixed steps" if stepped else ", tolerances")
                )
                view.plot(
                    [row.spent_s[case] * 1e3 for row in some],
                    [row.errors_m[case] for row in some],
                    style,
                    ms=4,
                    lw=1.4,
                    color=INK if ours else colour(number),
                    label=words,
                )
        view.set_xscale("log")
        view.set_yscale("log")
        view.set_xlabel("processor time for a simulated second (ms)")
        view.set_ylabel("error (m)")
    axes[1].legend(frameon=False, fontsize=7.5, loc="lower left")
    return figure
