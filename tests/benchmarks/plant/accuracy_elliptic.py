"""How much sooner ``exact`` is at 1e-10 than any other solver is at 1e-4, on the scene ``elliptic``.

``python tests/benchmarks/plant/accuracy_elliptic.py`` prints its method; SciPy and heyoka take part where they are
installed.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.scenes.files import load_scene
from deploy.studies.accuracy.report import AccuracyRow
from deploy.studies.accuracy.study import StudyPlan, study

FINE_M, COARSE_M = 1e-10, 1e-4
METHOD = """\
Method. mdms accuracy elliptic: 10 s, sampled every 4.096 ms, wall time of the plant without building it, medians of
{repeats} runs after one that warms up (that is long enough counts itself). Errors: largest displacement of any corner,
from {reference}. exact reaches {fine:g} m, every other solver {coarse:g} m:
"""


def cheapest(rows: list[AccuracyRow], error_m: float) -> AccuracyRow | None:
    """The row of least wall time that is right to ``error_m``."""
    good = [row for row in rows if row.error_max is not None and row.error_max <= error_m]
    return min(good, key=lambda row: row.wall_s or 0.0, default=None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="few settings of each solver")
    options = parser.parse_args()
    plan = (
        StudyPlan.of(quick=True, repeats=options.repeats)
        if options.quick
        else StudyPlan(repeats=options.repeats)
    )
    report = study(load_scene("elliptic"), replace(plan, sampling=False))
    best = {
        line: cheapest(
            [row for row in report.rows if row.line == line], FINE_M if line == "exact" else COARSE_M
        )
        for line in report.lines
    }
    exact = best.pop("exact")
    assert exact is not None
    assert exact.wall_s is not None
    ratios = {line: (row.wall_s or 0.0) / exact.wall_s for line, row in best.items() if row is not None}
    if options.json:
        print(json.dumps({"exact_wall_s": exact.wall_s, "ratios": ratios, "ratio": min(ratios.values())}))
        return
    print(
        METHOD.format(
            repeats=options.repeats, reference=report.reference.method, fine=FINE_M, coarse=COARSE_M
        )
    )
    print(f"{'exact':18}{exact.setting:26}{exact.error_max:9.1e} m{exact.wall_s * 1e3:10.2f} ms")
    for line, row in best.items():
        if row is None or row.wall_s is None:
            print(f"{line:18}at no setting")
            continue
        print(
            f"{line:18}{row.setting:26}{row.error_max:9.1e} m{row.wall_s * 1e3:10.2f} ms{ratios[line]:8.1f} times"
        )
    print(f"\nthe next takes {min(ratios.values()):.1f} times as long; must be more than once")


if __name__ == "__main__":
    main()
