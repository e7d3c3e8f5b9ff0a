import numpy as np
import pytest
from pydantic import ValidationError

from cell_firmware.toolkit.trajectory import ReferenceTrajectory, TrajectorySegment, at_all

LEGS = (
    TrajectorySegment(to_m=(0.3, 0.4)),
    TrajectorySegment(wait_s=2.0),
    TrajectorySegment(turn_rad=-1.0),
    TrajectorySegment(to_m=(0.3, -0.6), turn_rad=0.5),
)


def test_a_journey_is_where_its_legs_lead_at_their_speeds():
    """0.5 m at 0.1 m/s; 2 s; 1 rad at 0.5 rad/s; 1 m at 0.1 m/s, for which the turn slows down to 0.05 rad/s."""
    journey = ReferenceTrajectory((0.0, 0.0, 0.2), LEGS, 0.1, 0.5)
    assert journey.duration_s == pytest.approx(19.0)
    at = journey.at(np.array([0.0, 2.5, 6.0, 8.0, 14.0, 19.0, 30.0]))
    np.testing.assert_allclose(at.x, [0, 0.15, 0.3, 0.3, 0.3, 0.3, 0.3], atol=1e-12)
    np.testing.assert_allclose(at.y, [0, 0.2, 0.4, 0.4, -0.1, -0.6, -0.6], atol=1e-12)
    np.testing.assert_allclose(at.angle, [0.2, 0.2, 0.2, -0.3, -0.55, -0.3, -0.3], atol=1e-12)
    np.testing.assert_allclose(at.vx, [0.06, 0.06, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(at.vy, [0.08, 0.08, 0, 0, -0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(at.turning, [0, 0, 0, -0.5, 0.05, 0, 0], atol=1e-12)
    assert at.ended.tolist() == [False] * 5 + [True] * 2


def test_the_velocity_is_the_rate_at_which_the_reference_moves():
    journey, h = ReferenceTrajectory((0.1, -0.2, 0.0), LEGS, 0.13, 0.4), 1e-6
    time = np.linspace(0.013, journey.duration_s - 0.017, 200)
    before, at, after = (journey.at(time + d) for d in (-h, 0.0, h))
    for place, speed in (("x", "vx"), ("y", "vy"), ("angle", "turning")):
        rate = (getattr(after, place) - getattr(before, place)) / (2.0 * h)
        np.testing.assert_allclose(rate, getattr(at, speed), atol=1e-8)


def test_journeys_together_are_each_its_own():
    journeys = (
        ReferenceTrajectory((0, 0, 0), LEGS, 0.1, 0.5),
        ReferenceTrajectory((1, 1, 1), LEGS[:1], 0.2, 0.5),
    )
    time = np.array([[0.0, 1.0], [3.0, 99.0]])
    together = at_all(journeys, time)
    for j, journey in enumerate(journeys):
        alone = journey.at(time[:, j])
        assert np.array_equal(together.x[:, j], alone.x)
        assert np.array_equal(together.ended[:, j], alone.ended)


@pytest.mark.parametrize(
    "leg", [{}, {"wait_s": 1.0, "turn_rad": 1.0}, {"wait_s": 1.0, "to_m": [0, 0]}, {"wait_s": 0}]
)
def test_a_leg_moves_or_waits(leg: dict[str, object]):
    with pytest.raises(ValidationError, match="give wait_s, or to_m or turn_rad or both of these"):
        TrajectorySegment.model_validate(leg)
