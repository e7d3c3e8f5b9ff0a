"""What encoder, PWM and integers do to a wheel's speed: straying, rounding of the gains, recovery from saturation.

``python tests/benchmarks/cells/wheel_drive.py`` prints its method and the tables of ``docs/board.md``.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from cell_firmware.build import MotorFacts
from cell_firmware.components import WheelDriver
from cell_firmware.effects.pwm import TIMER_HZ
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop.fixed_point import FixedPointLoop
from tests.cell_firmware.speed_loop.wheels import (
    GAIN,
    PERIOD_S,
    RADIUS_M,
    SUPPLY_V,
    TAU_S,
    TURN_M,
    Wheel,
    drive,
    follow,
)

STUDY = SpeedLoopSpec(kp_v_per_m_s=6.0, ki_v_per_m=100.0)
TURNS_PER_S, BEGIN_S, END_S = 2.0, 4.0, 12.0
COULOMB, STATIC = 0.04, 0.07
TOP, AFTER, FAST = SUPPLY_V * GAIN, 0.5, 1.1
ENDLESS = MotorFacts(1e6, 1e5)
METHOD = f"""\
Method. A first-order motor solved exactly: time constant {TAU_S} s, {GAIN} m/s per volt, supply {SUPPLY_V} V,
wheel radius {RADIUS_M} m, period {PERIOD_S} s.
Straying: Coulomb friction {COULOMB:.0%} and static friction {STATIC:.0%} of the supply, {TURNS_PER_S} rev/s asked for,
kp {STUDY.kp_v_per_m_s} V per m/s, ki {STUDY.ki_v_per_m} V/m. The true speed at the ends of the periods from
{BEGIN_S} to {END_S} s: rms about its mean, peak to peak, and the mean less what was asked for.
Recovery: no friction. Saturated for a second, then {AFTER} m/s: the time until the wheel stays within 5 % of the way,
over that of the linear loop: in floating point, without limits, from its steady state at {TOP:g} m/s.
Run-up: no friction. From rest to {FAST} m/s: by how much of the way the wheel goes beyond.
Ripple: of a motor's speed under pulses of half a period, in closed form.
"""


def board(counts: int, levels: int) -> dict[str, Any]:
    return {"encoder": {"counts_per_revolution": counts}, "pwm": {"levels": levels}, "fixed_point": {}}


STRAYING: dict[str, dict[str, Any]] = {
    "none": {},
    "pwm, 2,000 levels": {"pwm": {}},
    "pwm, 255 levels": {"pwm": {"levels": 255}},
    "fixed_point": {"fixed_point": {}},
    "encoder, 256 counts": {"encoder": {}},
    "encoder, 1,920 counts": {"encoder": {"counts_per_revolution": 1920}},
    "all: 256 counts, 2,000 levels": board(256, 2000),
    "all: 256 counts, 255 levels": board(256, 255),
    "all: 1,920 counts, 2,000 levels": board(1920, 2000),
    "all: 1,920 counts, 255 levels": board(1920, 255),
}


def straying(effects: dict[str, Any], wanted: float = TURNS_PER_S) -> tuple[float, float, float]:
    """Rms, peak to peak and offset, rev/s."""
    begin, end = round(BEGIN_S / PERIOD_S), round(END_S / PERIOD_S)
    wheel = Wheel(COULOMB * SUPPLY_V, STATIC * SUPPLY_V)
    speeds = follow(drive(STUDY, **effects), [wanted * TURN_M] * end, wheel)[0][begin:] / TURN_M
    return float(speeds.std()), float(np.ptp(speeds)), float(speeds.mean()) - wanted


def recovery_s(part: WheelDriver, before: float) -> float:
    """How long until the wheel has come down to ``AFTER``."""
    begin = round(1.5 / PERIOD_S)  # half a second to get there
    speeds, _ = follow(part, [before] * begin + [AFTER] * 600, Wheel())
    way = np.abs(speeds[begin:] - AFTER)
    return float(np.flatnonzero(way > 0.05 * way[0])[-1] + 1) * PERIOD_S


def tell_straying() -> None:
    print(f"{'effects':34}{'rms, rev/s':>12}{'peaks':>10}{'offset':>10}")
    for name, effects in STRAYING.items():
        rms, peaks, offset = straying(effects)
        print(f"{name:34}{rms:12.2g}{peaks:10.2g}{offset:+10.2g}")


def tell_levels() -> None:
    wanted = (1.9, 1.95, 1.98, 1.99, 2.0, 2.01, 2.02, 2.05, 2.1)
    print(f"\n{'rms, 255 levels over 2,000':34}" + "".join(f"{speed:>6}" for speed in wanted) + " rev/s")
    for counts in (256, 1920):
        ratios = [straying(board(counts, 255), at)[0] / straying(board(counts, 2000), at)[0] for at in wanted]
        print(f"{f'{counts} counts':34}" + "".join(f"{ratio:6.2f}" for ratio in ratios))


def tell_rounding() -> None:
    columns = f"{'kp':>10}{'word':>8}{'shift':>7}{'ki':>10}{'word':>8}{'shift':>7}{'a step, V':>11}"
    print(f"\n{'default gains in integers':34}{columns}")
    for name, effects in STRAYING.items():
        if "fixed_point" not in effects:
            continue
        part = drive(**effects)
        assert isinstance(part, FixedPointLoop)
        kp, ki, _ = part.scaling.realised()
        gains = "".join(f"{gain.realised:10.4f}{gain.word:8}{gain.shift:7}" for gain in (kp, ki))
        print(f"{name:34}{gains}{part.scaling.rounding_v:11.1e}")


def tell_recovery() -> None:
    befores = (1.25, 1.3, 1.5, 2.0, 5.0)
    print(f"\n{'recovery from':34}" + "".join(f"{before:>7} m/s" for before in befores))
    for kp, ki in ((12.0, 200.0), (6.0, 100.0), (12.0, 400.0)):
        gains = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki)
        linear = recovery_s(drive(gains, ENDLESS), TOP)
        for name, effects in (("float", {}), ("fixed", {"fixed_point": {}}), ("board", board(1920, 2000))):
            ratios = [recovery_s(drive(gains, **effects), before) / linear for before in befores]
            print(f"{f'kp {kp:g}, ki {ki:g}, {name}':34}" + "".join(f"{ratio:11.2f}" for ratio in ratios))


def tell_run_up() -> None:
    print(f"\n{'beyond, of the run-up':34}{'with limits':>12}{'without':>10}")
    for kp, ki, ahead in ((12.0, 200.0, 0.0), (12.0, 400.0, 0.0), (12.0, 200.0, 10.0)):
        gains = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead)
        limited, free = (
            max(0.0, float(follow(part, [FAST] * 400, Wheel())[0].max()) / FAST - 1.0)
            for part in (drive(gains), drive(gains, ENDLESS))
        )
        print(f"{f'kp {kp:g}, ki {ki:g}, kf {ahead:g}':34}{limited:12.1%}{free:10.1%}")


def tell_ripple() -> None:
    """Speed decays by d in each half of a pulse period: it goes from ``d / (1 + d)`` to ``1 / (1 + d)`` of all."""
    for levels in (2000, 256):
        decay = math.exp(-levels / TIMER_HZ / 2.0 / TAU_S)
        share = (1.0 - decay) / (1.0 + decay)
        print(
            f"\nripple, {levels} levels: {share * TOP:.2g} m/s peak to peak, {share:.2%} of the free speed",
            end="",
        )
    print()


def main() -> None:
    print(METHOD)
    tell_straying()
    tell_levels()
    tell_rounding()
    tell_recovery()
    tell_run_up()
    tell_ripple()


if __name__ == "__main__":
    main()
