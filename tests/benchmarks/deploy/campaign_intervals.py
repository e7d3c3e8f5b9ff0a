"""How often a campaign's interval of a mean covers it, beside a bootstrap's.

``python tests/benchmarks/deploy/campaign_intervals.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.studies.campaign.report import mean_of

METHOD = """\
Method. {samples:,} samples of each size from distributions of mean 1; how many of the 95 % intervals hold it.
Bootstrap: SciPy's, bias-corrected and accelerated, 999 resamples.
"""
DISTRIBUTIONS = {
    "normal, spread 0.2": lambda draw, size: draw.normal(1.0, 0.2, size),
    "exponential": lambda draw, size: draw.exponential(1.0, size),
}


def of_student(samples: NDArray[np.float64]) -> float:
    """Share of the campaign's intervals that hold 1."""
    found = [mean_of(sample, 0.95) for sample in samples.tolist()]
    return float(np.mean([one.low <= 1.0 <= one.high for one in found]))


def of_bootstrap(samples: NDArray[np.float64]) -> float:
    """Share of a bootstrap's intervals that hold 1."""
    chance = np.random.default_rng(3)
    found = bootstrap((samples,), np.mean, axis=1, n_resamples=999, batch=50, method="BCa", rng=chance)
    interval = found.confidence_interval
    return float(np.mean((interval.low <= 1.0) & (interval.high >= 1.0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1000, help="of each size")
    number: int = parser.parse_args().samples
    print(METHOD.format(samples=number))
    print(f"{'':22}{'runs':>5}{'Student t':>11}{'bootstrap':>11}")
    for name, sample in DISTRIBUTIONS.items():
        for runs in (3, 5, 10, 20, 50):
            samples = sample(np.random.default_rng(7), (number, runs))
            print(f"{name:22}{runs:5}{of_student(samples):11.1%}{of_bootstrap(samples):11.1%}")


if __name__ == "__main__":
    main()
