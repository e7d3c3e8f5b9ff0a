"""Distances of convex polygons, and the certainty that two stay apart: against independent ways of finding them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from plant.effects.parcel_contact.bodies import pack
from plant.kernels.contact import entry as contact_entry
from plant.kernels.contact import layout as to
from tests.plant.effects.parcel_contact.benches import Floats, placed, polygons

PLACE = st.floats(-2.0, 2.0)
TURN = st.floats(-4.0, 4.0)


def _state(x: float, y: float, angle: float, *rates: float) -> Floats:
    return np.array([x, y, angle, *(rates or (0.0, 0.0, 0.0))])


def _least_distance(a: Floats, b: Floats) -> float:
    """Distance of two hulls: the point nearest to the origin in the hull of all differences, by NNLS."""
    differences = (a[:, None, :] - b[None, :, :]).reshape(-1, 2)
    heavy = 1e4  # the weights must sum to one
    system = np.vstack([differences.T, heavy * np.ones(len(differences))])
    weights, _ = nnls(system, np.array([0.0, 0.0, heavy]))
    return float(np.hypot(*(differences.T @ weights / weights.sum())))


@settings(max_examples=80)
@given(polygons(), polygons(), PLACE, PLACE, TURN, TURN)
def test_the_gap_is_the_distance_of_the_hulls(
    a: Floats, b: Floats, x: float, y: float, turn_a: float, turn_b: float
) -> None:
    pa, pb = _state(0.0, 0.0, turn_a), _state(x, y, turn_b)
    gap, nx, ny = contact_entry.gap(pack([a, b]), 0, 1, pa, pb)
    assert nx * nx + ny * ny == pytest.approx(1.0, abs=1e-12)
    if gap > 1e-6:
        assert gap == pytest.approx(_least_distance(placed(a, pa), placed(b, pb)), abs=1e-7)
        # and the direction is the one in which it closes soonest
        touching = _state(x - gap * nx, y - gap * ny, turn_b)
        assert contact_entry.gap(pack([a, b]), 0, 1, pa, touching)[0] == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=60)
@given(polygons(), polygons(), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), TURN)
def test_the_depth_is_the_least_push_that_parts_them(
    a: Floats, b: Floats, x: float, y: float, turn: float
) -> None:
    assume(len(a) > 2 and len(b) > 2)
    pa, pb = _state(0.0, 0.0, 0.0), _state(x, y, turn)
    gap, nx, ny = contact_entry.gap(pack([a, b]), 0, 1, pa, pb)
    if gap < 0.0:
        apart = _state(x - gap * nx, y - gap * ny, turn)
        assert contact_entry.gap(pack([a, b]), 0, 1, pa, apart)[0] == pytest.approx(0.0, abs=1e-12)
        angles = np.linspace(0.0, 2.0 * np.pi, 721)
        every = np.stack([np.cos(angles), np.sin(angles)])
        pushes = (placed(a, pa) @ every).max(axis=0) - (placed(b, pb) @ every).min(axis=0)
        assert -gap <= pushes.min() + 1e-12


def test_a_million_metres_away_it_keeps_the_digits_that_the_shift_leaves() -> None:
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    near = contact_entry.gap(pack([square, square]), 0, 1, _state(0, 0, 0.3), _state(2.0, 0.25, 0.8))[0]
    far = contact_entry.gap(
        pack([square, square]), 0, 1, _state(1e6, 1e6, 0.3), _state(1e6 + 2.0, 1e6 + 0.25, 0.8)
    )[0]
    assert far == pytest.approx(near, abs=1e-14)


@settings(max_examples=150)
@given(
    polygons(),
    polygons(),
    st.tuples(PLACE, PLACE, TURN, TURN),
    st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12),
    st.floats(0.01, 0.3),
)
def test_what_is_certain_to_stay_apart_does_at_every_instant_between(
    a: Floats, b: Floats, start: tuple[float, ...], rates: list[float], span: float
) -> None:
    x, y, turn_a, turn_b = start

    def motion(first: Floats, rate: Floats, bend: Floats, t: Floats) -> Floats:
        pose = first + rate * t[:, None] + 0.5 * bend * t[:, None] ** 2
        return np.concatenate([pose, rate + bend * t[:, None]], axis=1)

    v = np.array(rates).reshape(4, 3)
    t = np.linspace(0.0, span, 60)
    paths = [
        motion(np.array([0.0, 0.0, turn_a]), v[0], v[1], t),
        motion(np.array([x, y, turn_b]), v[2], v[3], t),
    ]
    shapes = pack([a, b])
    pull = np.zeros((2, to.PULL_SIZE))
    pull[:, to.RADIUS] = [np.hypot(*a.T).max(), np.hypot(*b.T).max()]
    pull[:, to.PUSH] = [
        np.hypot(*bend[:2]) + radius * abs(bend[2])
        for bend, radius in zip(v[[1, 3]], pull[:, to.RADIUS], strict=True)
    ]
    ends = np.stack([[paths[0][0], paths[1][0]], [paths[0][-1], paths[1][-1]]])
    pair = np.array([[0, 1]])
    _, unsure = contact_entry.first_uncertain(shapes, pair, pull, 0.0, t[[0, -1]], ends, 0)
    if unsure < 0:
        gaps = [contact_entry.gap(shapes, 0, 1, *states)[0] for states in zip(*paths, strict=True)]
        assert min(gaps) > 0.0


def test_faces_a_nanometre_apart_are_separated_along_their_normal() -> None:
    """Corners that face each other are nearest too, and the direction between them is rounding: askew by 1e-8."""
    half = 0.125
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    shapes = pack([square, square])
    first = np.array([0.2749999971380149, 0.5249999990001986, 1.9585805295037434e-18])
    second = np.array([0.5249999990001984, 0.5249999990001986, -1.3408324108140742e-16])
    distance, x, y = contact_entry.gap(shapes, 0, 1, first, second)
    assert distance == pytest.approx(1.8621835e-9, abs=1e-14)
    assert (x, y) == pytest.approx((1.0, 0.0), abs=1e-15)


def test_a_corner_that_stays_beside_a_turning_face_is_seen_to_stay_clear() -> None:
    """A line fixed along the face would cut into the face's far end, at any gap as small, in all but a short time."""
    half, gap, omega, span = 0.15, 2e-7, -1.0, 1e-4
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    diamond = np.array([(0.0, -0.1), (0.1, 0.0), (0.0, 0.1), (-0.1, 0.0)])
    # the diamond's lower corner hangs over the square's upper face, and goes along with it as one body would
    there, turned = np.array([0.1, half + gap + 0.1]), omega * span
    back = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]) @ there

    def states(place: Floats, angle: float) -> Floats:
        velocity = omega * np.array([-place[1], place[0]])
        return np.array([[0.0, 0.0, angle, 0.0, 0.0, omega], [*place, angle, *velocity, omega]])

    pull = np.zeros((2, to.PULL_SIZE))
    pull[:, to.PUSH] = 1.0
    _, unsure = contact_entry.first_uncertain(
        pack([square, diamond]),
        np.array([[0, 1]]),
        pull,
        0.0,
        np.array([0.0, span]),
        np.stack([states(there, 0.0), states(back, turned)]),
        0,
    )
    assert unsure < 0


def test_turning_squares_that_graze_are_not_taken_to_stay_clear() -> None:
    """Spans about as long as it takes to meet, so that bounds on what corners do are what decides."""
    draw, clear = np.random.default_rng(3), 0
    half = 0.15
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    shapes, pair = pack([square, square]), np.array([[0, 1]])
    for _ in range(6000):
        space, pull = 10.0 ** draw.uniform(-6.0, -2.0), 10.0 ** draw.uniform(-3.0, 1.0)
        starts = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, draw.uniform(0.0, np.pi)]])
        # the second's lowest corner is as far above the first's upper face
        low = (placed(square, starts[1])[:, 1]).min()
        starts[1, :2] = draw.uniform(-0.2, 0.2), half + space - low
        rates = draw.normal(0.0, [0.1, 0.1, 3.0], (2, 3))
        angle = draw.uniform(0.0, 2.0 * np.pi, 2)
        bends = pull * np.stack([np.cos(angle), np.sin(angle), np.zeros(2)], axis=1)
        speed = np.abs(rates).sum() * half + pull * 1e-3
        span = float(draw.uniform(0.2, 3.0)) * min(space / speed, (2.0 * space / pull) ** 0.5) * 3.0
        t = np.linspace(0.0, span, 40)[:, None, None]
        states = np.concatenate([starts + rates * t + 0.5 * bends * t * t, rates + bends * t], axis=2)
        bounds = np.zeros((2, to.PULL_SIZE))
        # of a corner: the parcel's own and that of its turning
        bounds[:, to.PUSH] = pull
        bounds[:, to.RADIUS] = half * 2.0**0.5
        times = np.array([0.0, span])
        unsure = contact_entry.first_uncertain(shapes, pair, bounds, 0.0, times, states[[0, -1]], 0)[1]
        if unsure < 0:
            clear += 1
            assert min(contact_entry.gap(shapes, 0, 1, *both)[0] for both in states) > 0.0
    assert clear > 1000


def test_a_corner_that_flies_across_a_turning_face_is_seen_to_dip_into_it() -> None:
    """As far above the face's line at both ends; on the way the line turns up under a straight path."""
    half, size, gap, omega, speed, span = 0.15, 0.005, 1e-3, 3.0, 2.0, 0.03
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    diamond = size * np.array([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)])
    tilt, across = 0.5 * omega * span, 0.5 * speed * span
    # the lowest corner over the face's line at both ends, mirror images of each other
    height = (half + gap) / np.cos(tilt) - across * np.tan(tilt) + size
    t = np.linspace(-0.5 * span, 0.5 * span, 61)[:, None]
    zero, one = np.zeros_like(t), np.ones_like(t)
    turning = np.concatenate([zero, zero, omega * t, zero, zero, omega * one], axis=1)
    flying = np.concatenate([-speed * t, height * one, zero, -speed * one, zero, zero], axis=1)
    states, shapes = np.stack([turning, flying], axis=1), pack([square, diamond])
    gaps = [contact_entry.gap(shapes, 0, 1, *both)[0] for both in states]
    assert min(gaps[0], gaps[-1]) > 0.5 * gap
    assert min(gaps) < 0.0
    bounds = np.zeros((2, to.PULL_SIZE))
    bounds[:, to.RADIUS] = half * 2.0**0.5, size
    times = np.array([0.0, span])
    _, unsure, *_ = contact_entry.first_uncertain(
        shapes, np.array([[0, 1]]), bounds, 0.0, times, states[[0, -1]], 0
    )
    assert unsure == 0
