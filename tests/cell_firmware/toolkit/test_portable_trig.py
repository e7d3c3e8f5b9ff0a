import math

import numpy as np

from cell_firmware.toolkit.portable_trig import direction


def test_cosine_and_sine_are_those_of_the_angle_to_rounding():
    angle = np.concatenate((np.linspace(-20.0, 20.0, 40_001), np.arange(-40, 41) * math.pi / 4))
    cosine, sine = direction(angle)
    wanted = np.array([(math.cos(a), math.sin(a)) for a in angle.tolist()])
    assert abs(cosine - wanted[:, 0]).max() <= 3e-16
    assert abs(sine - wanted[:, 1]).max() <= 3e-16


def test_an_angle_alone_has_the_same_bits_as_among_many():
    angle = np.random.default_rng(3).uniform(-50.0, 50.0, 1003)
    together = np.stack(direction(angle))
    alone = np.concatenate([np.stack(direction(angle[i : i + 1])) for i in range(len(angle))], axis=1)
    assert together.tobytes() == alone.tobytes()


def test_a_million_turns_on_it_is_still_the_direction():
    turns = np.array([1e5, 1e6]) * 2.0 * math.pi
    cosine, sine = direction(turns + 1.0)
    np.testing.assert_allclose(cosine, np.cos(turns + 1.0), atol=1e-14)
    np.testing.assert_allclose(sine, np.sin(turns + 1.0), atol=1e-14)
