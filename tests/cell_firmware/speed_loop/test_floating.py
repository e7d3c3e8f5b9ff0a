import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop import SpeedLoop
from tests.cell_firmware.speed_loop.wheels import GAIN, PERIOD_S, SUPPLY_V, TAU_S, cells


class Motor:
    """First-order motors under constant voltage over a period, solved exactly: speed and travel."""

    def __init__(self, n: int = 1) -> None:
        self.speed = np.zeros((n, 2))
        self.travel = np.zeros((n, 2))

    def advance(self, volts: NDArray[np.float64]) -> None:
        decay = np.exp(-PERIOD_S / TAU_S)
        target = GAIN * volts
        self.travel = self.travel + target * PERIOD_S + (self.speed - target) * TAU_S * (1 - decay)
        self.speed = target + (self.speed - target) * decay


def closed(
    loop: SpeedLoop, reference: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speeds and voltages ``(ticks,)`` of one wheel that follows ``reference``."""
    motor, state = Motor(), loop.init(cells(1))
    speeds, volts = [], []
    for wanted in reference:
        speeds.append(motor.speed[0, 0])
        state, u = loop.step(state, np.full((1, 2), wanted), motor.travel)
        volts.append(u[0, 0])
        motor.advance(u)
    return np.array(speeds), np.array(volts)


@pytest.mark.parametrize(
    ("kp", "ki", "ahead"),
    [(12.0, 200.0, 0.0), (12.0, 200.0, 2.0), (6.0, 100.0, 10.0), (20.0, 30.0, 0.0), (0.0, 60.0, 0.0)],
)
def test_the_step_responses_of_both_wheels_are_those_of_the_sampled_closed_loop(
    kp: float, ki: float, ahead: float
) -> None:
    """An independent model: motor, travel, last travel and integral as one linear system in SciPy."""
    from scipy.linalg import expm
    from scipy.signal import StateSpace, dlsim

    t = PERIOD_S
    # motor: x = (speed, travel), dx/dt = A x + B u, held input
    block = np.zeros((3, 3))
    block[0, 0], block[0, 2], block[1, 0] = -1 / TAU_S, GAIN / TAU_S, 1.0
    held = expm(block * t)
    ad, bd = held[:2, :2], held[:2, 2]
    # state z = (speed, travel, travel before, integral); e = r - (travel - before) / t
    e = np.array([0, -1 / t, 1 / t, 0])
    i_next = np.array([0, 0, 0, 1.0]) + ki * t * e
    u = kp * e + i_next
    u_r = ahead + kp + ki * t
    a = np.zeros((4, 4))
    a[:2, :2] = ad
    a[:2] += np.outer(bd, u)
    a[2, 1] = 1.0
    a[3] = i_next
    b = np.concatenate([bd * u_r, [0.0], [ki * t]])[:, None]
    system = StateSpace(a, b, np.vstack([np.eye(4)[0], u]), np.array([[0.0], [u_r]]), dt=t)

    spec = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead)
    loop, motor = SpeedLoop(spec, t, SUPPLY_V), Motor()
    state = loop.init(cells(1))
    reference = np.array([[0.3, -0.11]])
    speeds, volts = [], []
    for _ in range(200):
        speeds.append(motor.speed[0])
        state, acting = loop.step(state, reference, motor.travel)
        volts.append(acting[0])
        motor.advance(acting)
    for wheel, step in enumerate(reference[0]):
        _, response, _ = dlsim(system, np.full((200, 1), step))
        np.testing.assert_allclose(np.array(speeds)[:, wheel], response[:, 0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.array(volts)[:, wheel], response[:, 1], rtol=0, atol=1e-9)


def test_the_default_gains_settle_the_default_motor_in_a_fifth_of_a_second_and_stay():
    speeds, _ = closed(SpeedLoop(SpeedLoopSpec(), PERIOD_S, SUPPLY_V), np.full(2000, 0.4))
    time = np.arange(2000) * PERIOD_S
    assert np.abs(speeds[time >= 0.2] / 0.4 - 1).max() < 0.02
    assert abs(speeds[-1] - 0.4) < 1e-12
    assert speeds.max() < 0.4 * 1.05


def test_commands_never_exceed_the_supply():
    _, volts = closed(SpeedLoop(SpeedLoopSpec(), PERIOD_S, 2.0), np.repeat([5.0, -5.0], 100))
    assert volts.max() == 2.0
    assert volts.min() == -2.0


def test_a_reference_out_of_reach_does_not_wind_the_integral_up():
    """However long the wheel was saturated, it leaves saturation at once, and in the same way."""

    def recovery(saturated_ticks: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        reference = np.concatenate([np.full(saturated_ticks, 5.0), np.full(150, 0.5)])
        speeds, volts = closed(SpeedLoop(SpeedLoopSpec(), PERIOD_S, SUPPLY_V), reference)
        return speeds[saturated_ticks:], volts[saturated_ticks:]

    (speeds, volts), (later, _) = recovery(500), recovery(3000)
    assert volts[0] < SUPPLY_V
    np.testing.assert_allclose(speeds, later, atol=1e-9)
    assert np.abs(speeds[round(0.4 / PERIOD_S) :] / 0.5 - 1).max() < 0.02


def test_saturated_at_the_other_end_the_integral_moves_towards_that_end():
    loop = SpeedLoop(SpeedLoopSpec(), PERIOD_S, 1.0)
    state = loop.init(cells(1))
    for _ in range(1000):
        state, _ = loop.step(state, np.full((1, 2), 0.08), np.zeros((1, 2)))
    for _ in range(1000):
        before = state["integral_v"][0, 0]
        state, volts = loop.step(state, np.full((1, 2), -5.0), np.zeros((1, 2)))
        assert volts[0, 0] == -1.0
        assert -1.0 <= state["integral_v"][0, 0] <= before
    assert state["integral_v"][0, 0] == pytest.approx(-1.0, abs=1e-12)


gain = st.just(0.0) | st.floats(1e-3, 1e4)
speed = st.floats(-10, 10)


@given(gain, gain, gain, st.lists(st.tuples(speed, speed), min_size=1, max_size=40))
def test_whatever_a_wheel_does_the_integral_stays_within_supply_and_feed_forward(
    kp: float, ki: float, ahead: float, rows: list[tuple[float, float]]
):
    """References and travel of each period are arbitrary: a wheel that can't follow, is blocked or is turned back."""
    loop = SpeedLoop(
        SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead), PERIOD_S, SUPPLY_V
    )
    state, travel, fastest = loop.init(cells(1)), 0.0, 0.0
    for i, (reference, measured) in enumerate(rows):
        if i:
            travel += measured * PERIOD_S
            fastest = max(fastest, abs(measured))
        state, _ = loop.step(state, np.full((1, 2), reference), np.full((1, 2), travel))
        most = SUPPLY_V + ahead * fastest
        rounding = 1e-9 * (1.0 + kp + ahead)
        assert np.abs(state["integral_v"]).max() <= most + rounding


def test_the_first_reading_counts_as_standing_still_whatever_the_encoder_says():
    loop = SpeedLoop(SpeedLoopSpec(), PERIOD_S, SUPPLY_V)
    _, volts = loop.step(loop.init(cells(1)), np.zeros((1, 2)), np.array([[123.0, -4.0]]))
    np.testing.assert_array_equal(volts, [[0.0, 0.0]])


def test_wheels_do_not_influence_each_other():
    loop = SpeedLoop(SpeedLoopSpec(), PERIOD_S, SUPPLY_V)
    _, volts = loop.step(
        loop.init(cells(3)), np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]), np.zeros((3, 2))
    )
    assert (volts != 0).tolist() == [[True, False], [False, False], [False, True]]
    assert volts[0, 0] == -volts[2, 1]


value = st.floats(-100, 100)
pair = st.tuples(value, value)


@given(st.lists(st.tuples(pair, pair, pair), min_size=1, max_size=20))
def test_a_cell_alone_gets_the_same_bits_as_among_many(
    rows: list[tuple[tuple[float, float], tuple[float, float], tuple[float, float]]],
):
    reference, first, second = (np.array(part) for part in zip(*rows, strict=True))
    loop = SpeedLoop(SpeedLoopSpec(feed_forward_v_per_m_s=3.0), PERIOD_S, SUPPLY_V)

    def volts(chosen: slice) -> bytes:
        state, _ = loop.step(loop.init(cells(len(reference[chosen]))), reference[chosen], first[chosen])
        state, out = loop.step(state, reference[chosen], second[chosen])
        return out.tobytes()

    together = volts(slice(None))
    alone = b"".join(volts(slice(i, i + 1)) for i in range(len(rows)))
    assert together == alone


@pytest.mark.parametrize(("period_s", "supply_v"), [(0.0, 12.0), (0.004, 0.0), (0.004, float("nan"))])
def test_a_loop_without_time_or_supply_is_refused(period_s: float, supply_v: float):
    with pytest.raises(FirmwareError, match="must be positive and finite"):
        SpeedLoop(SpeedLoopSpec(), period_s, supply_v)
