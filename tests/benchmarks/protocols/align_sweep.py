"""How well a size sweep of parcels is aligned: open loop, and in closed loop by sensors and by camera.

Run: ``python tests/benchmarks/protocols/align_sweep.py`` (table; ``--output docs/images`` for the picture, ``--sensors
    N``).

Parcels of half-sizes 0.21 to 0.37 m by 0.19 to 0.23 m, 9 by 5, begin up to 0.2 m from the middle of 15 by 15 cells
along x and y, at any angle, and are to lie along the rows. Open loop they are in the elliptic field of the paper, for
60 s; in closed loop ``align`` has 15 s. By how much are they off? Half a turn looks the same, and of the two squares
among them a quarter.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.plots.map_view import INK
from deploy.plots.theme import draw_heading, write_picture
from deploy.util.colours import colour
from tests.benchmarks.protocols.align_case import Case, Floats, Start, off_deg, run, starts

LENGTHS_M: Final = np.round(2.0 * np.linspace(0.21, 0.37, 9), 6)
WIDTHS_M: Final = np.round(2.0 * np.linspace(0.19, 0.23, 5), 6)
SIZES_M: Final = [(float(length), float(width)) for length in LENGTHS_M for width in WIDTHS_M]
CAMERA: Final = {"period_s": 0.04, "latency_s": 0.04, "position_noise_m": 0.002, "angle_noise_rad": 0.01}
ELLIPTIC: Final = {"field": {"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0}}


def cases(begun: list[Start], sensors: int) -> dict[str, Case]:
    """What is compared."""
    still = {"target_m": (0.0, 0.0)}
    return {
        "open loop": Case(begun, "velocity_field", ELLIPTIC, sensors, 60.0),
        "sensors": Case(begun, "align", {"source": "sensors", **still}, sensors),
        "camera": Case(begun, "align", {"source": "camera", **still}, sensors, camera=CAMERA),
    }


def main() -> None:
    """Print the table; draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensors", type=int, default=5, choices=(1, 5))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--quick", action="store_true", help="three sizes, a tenth of the time, no picture")
    asked = parser.parse_args()
    sizes = SIZES_M[:: len(SIZES_M) // 3] if asked.quick else SIZES_M
    found: dict[str, tuple[Floats, Floats]] = {}
    print(f"{len(sizes)} sizes, {asked.sensors} sensor(s) a cell, seed {asked.seed}; degrees off at the end")
    print(f"{'':10}{'median':>8}{'90 %':>8}{'worst':>8}{'over 5':>8}{'mm off':>8}{'cpu s':>8}")
    begun = starts(sizes, asked.seed)
    for name, whole in cases(begun, asked.sensors).items():
        case = replace(whole, seconds=whole.seconds / 10) if asked.quick else whole
        began = time.process_time()
        found[name] = run(case)
        states = found[name][1]
        off, at_m = off_deg(states[-1], begun), np.hypot(states[-1, :, 0], states[-1, :, 1])
        print(
            f"{name:10}{np.median(off):8.2f}{np.quantile(off, 0.9):8.2f}{off.max():8.2f}"
            f"{np.mean(off > 5.0):8.0%}{1e3 * np.median(at_m):8.2f}{time.process_time() - began:8.0f}"
        )
    if asked.output is not None and not asked.quick:
        asked.output.mkdir(parents=True, exist_ok=True)
        write_picture(lambda: draw(found, begun, asked.sensors), asked.output / "align.png")


def draw(found: dict[str, tuple[Floats, Floats]], begun: list[Start], sensors: int) -> Figure:
    """Draw angles over time above, and where they end over the sizes below."""
    from matplotlib import colors

    titles = {
        "open loop": "open loop: elliptic field",
        "sensors": f"align, {sensors} binary sensor{'s' * (sensors > 1)} a cell",
        "camera": "align, camera",
    }
    figure = Figure(figsize=(10.5, 7.2))
    draw_heading(
        figure,
        "Parcels of 45 sizes turned to an angle",
        "off by how much over time, and at the end over length and width; black: median",
        0.35,
    )
    axes = figure.subplots(
        2,
        3,
        squeeze=False,
        gridspec_kw={
            "height_ratios": (1.15, 1.0), "left": 0.08, "right": 0.88, "top": 0.84, "bottom": 0.08,
            "hspace": 0.28, "wspace": 0.22,
        },
    )  # fmt: skip
    scale = colors.LogNorm(0.05, 90.0)
    shape = (len(LENGTHS_M), len(WIDTHS_M))
    for column, (name, (times, states)) in enumerate(found.items()):
        off = np.maximum(off_deg(states, begun), 1e-3)
        above, below = axes[0, column], axes[1, column]
        above.semilogy(times, off, color=colour(0), alpha=0.35, linewidth=0.8)
        above.semilogy(times, np.median(off, axis=1), color=INK, linewidth=1.6, label="median")
        above.axhline(2.0, color=colour(2), linestyle="--", linewidth=1.0, label="2°")
        above.axhline(6.0, color=colour(1), linestyle="--", linewidth=1.0, label="6°")
        above.set_title(titles[name], loc="left", size=10)
        above.set(xlabel="time (s)", ylim=(0.01, 120.0), xlim=(0.0, times[-1]))
        image = below.imshow(
            off[-1].reshape(shape).T, origin="lower", norm=scale, cmap="viridis_r", aspect="auto"
        )
        below.set_xticks(range(0, shape[0], 2), [f"{length:.2f}" for length in LENGTHS_M[::2]])
        below.set_yticks(range(shape[1]), [f"{width:.2f}" for width in WIDTHS_M])
        below.set(xlabel="length (m)")
        for (i, j), value in np.ndenumerate(off[-1].reshape(shape)):
            dark = value > 3.0
            text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
            below.text(i, j, text, ha="center", va="center", fontsize=6.5, color="white" if dark else "black")
    axes[0, 0].set_ylabel("off by (degrees)")
    axes[1, 0].set_ylabel("width (m)")
    axes[0, 0].legend(frameon=False, loc="lower left", fontsize=8)
    bar = figure.add_axes((0.9, 0.08, 0.015, 0.32))
    figure.colorbar(image, cax=bar, label="off at the end (degrees)")
    return figure


if __name__ == "__main__":
    main()
