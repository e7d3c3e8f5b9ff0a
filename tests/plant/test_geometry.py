"""Polygons against closed forms, triangulation and point sampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from plant import geometry
from plant.geometry import PolygonError


def _regular(corners: int, radius: float, angle: float = 0.0) -> list[tuple[float, float]]:
    turn = angle + 2.0 * np.pi * np.arange(corners) / corners
    return [(radius * float(np.cos(t)), radius * float(np.sin(t))) for t in turn]


@st.composite
def convex(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Corners on an ellipse, anywhere, in either direction."""
    steps = draw(st.lists(st.floats(0.3, 1.0), min_size=3, max_size=9))
    angle = np.cumsum(steps) / sum(steps) * 2.0 * np.pi
    a, b = draw(st.floats(0.1, 2.0)), draw(st.floats(0.1, 2.0))
    x, y = draw(st.floats(-5.0, 5.0)), draw(st.floats(-5.0, 5.0))
    points = [(x + a * float(np.cos(t)), y + b * float(np.sin(t))) for t in angle]
    return points[::-1] if draw(st.booleans()) else points


def _triangles(vertices: list[tuple[float, float]]) -> tuple[float, np.ndarray, float]:
    """Area, centroid and polar second moment about the centroid, from a fan of triangles and Steiner's theorem."""
    v = np.array(vertices)
    area, first, parts = 0.0, np.zeros(2), []
    for i in range(1, len(v) - 1):
        t = v[[0, i, i + 1]]
        e, f = t[1] - t[0], t[2] - t[0]
        size = 0.5 * abs(e[0] * f[1] - e[1] * f[0])
        middle = t.mean(axis=0)
        own = size / 36.0 * sum(float(np.sum((t[j] - t[k]) ** 2)) for j, k in ((0, 1), (1, 2), (2, 0)))
        area, first = area + size, first + size * middle
        parts.append((size, middle, own))
    centroid = first / area
    return area, centroid, sum(own + size * float(np.sum((m - centroid) ** 2)) for size, m, own in parts)


def test_a_rectangle_has_the_textbook_area_centroid_and_inertia() -> None:
    corners = geometry.rectangle(0.54, 0.32)
    assert geometry.signed_area(corners) == pytest.approx(0.54 * 0.32, rel=1e-15)
    assert geometry.centroid(corners) == pytest.approx((0.0, 0.0), abs=1e-17)
    assert geometry.polar_moment_per_mass(corners) == pytest.approx((0.54**2 + 0.32**2) / 12.0, rel=1e-15)


@pytest.mark.parametrize(("corners", "factor"), [(3, 1.0 / 4.0), (4, 1.0 / 3.0), (6, 5.0 / 12.0)])
def test_a_regular_polygon_has_the_textbook_inertia(corners: int, factor: float) -> None:
    polygon = _regular(corners, 0.3, angle=0.2)
    assert geometry.polar_moment_per_mass(polygon) == pytest.approx(factor * 0.09, rel=1e-14)


@given(convex())
def test_area_centroid_and_inertia_agree_with_a_triangulation(vertices: list[tuple[float, float]]) -> None:
    area, centroid, second = _triangles(vertices)
    assert abs(geometry.signed_area(vertices)) == pytest.approx(area, rel=1e-9)
    assert geometry.centroid(vertices) == pytest.approx(tuple(centroid), abs=1e-9)
    assert geometry.polar_moment_per_mass(vertices) == pytest.approx(second / area, rel=1e-8)


@given(convex())
def test_neither_direction_nor_first_corner_matters(vertices: list[tuple[float, float]]) -> None:
    others = vertices[::-1][1:] + vertices[::-1][:1]
    assert geometry.signed_area(others) == pytest.approx(-geometry.signed_area(vertices), rel=1e-9)
    assert geometry.centroid(others) == pytest.approx(geometry.centroid(vertices), abs=1e-9)
    assert geometry.signed_area([tuple(p) for p in geometry.counter_clockwise(vertices)]) > 0.0


def test_inertia_far_from_the_origin_keeps_its_digits() -> None:
    near = geometry.polar_moment_per_mass(geometry.rectangle(0.5, 0.25))
    far = [(x + 1e6, y - 1e6) for x, y in geometry.rectangle(0.5, 0.25)]
    assert geometry.polar_moment_per_mass(far) == pytest.approx(near, rel=1e-9)


@pytest.mark.parametrize(
    ("vertices", "text"),
    [
        ([(0, 0), (1, 0)], "at least 3 corners, not 2"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "corner 1 is given twice"),
        ([(0, 0), (1, 0), (0.2, 0.2), (0, 1)], "corner 2 is not convex"),
        ([(0, 0), (0, 1), (0.2, 0.2), (1, 0)], "corner 2 is not convex"),
        ([(0, 0), (0.5, 0), (1, 0), (0, 1)], "corner 1 is not convex"),
        ([(0, 0), (1, 1), (2, 2)], "is not convex"),
        (_regular(5, 1.0)[::2] + _regular(5, 1.0)[1::2], "go round more than once"),
    ],
)
def test_corners_that_are_no_convex_polygon_are_refused(
    vertices: list[tuple[float, float]], text: str
) -> None:
    with pytest.raises(PolygonError, match=text):
        geometry.check_convex(vertices)


@given(convex())
def test_convex_polygons_are_accepted(vertices: list[tuple[float, float]]) -> None:
    geometry.check_convex(vertices)


@given(convex(), st.floats(0.0, 6.0), st.floats(0.0, 4.0))
def test_edges_measure_how_far_inside_a_point_lies(
    vertices: list[tuple[float, float]], angle: float, distance: float
) -> None:
    corners = geometry.counter_clockwise(vertices)
    centre = corners.mean(axis=0)
    point = centre + distance * np.array([np.cos(angle), np.sin(angle)])
    normal, offset = geometry.edges(corners)
    assert np.hypot(normal[:, 0], normal[:, 1]) == pytest.approx(1.0, rel=1e-14)
    following = np.roll(corners, -1, axis=0)
    cross = (following - corners)[:, 0] * (point - corners)[:, 1] - (following - corners)[:, 1] * (
        point - corners
    )[:, 0]
    length = np.hypot(*(following - corners).T)
    assert offset - normal @ point == pytest.approx(cross / length, abs=1e-12)


def _squares(gap: float) -> tuple[np.ndarray, np.ndarray]:
    square = np.array(geometry.rectangle(1.0, 1.0))
    return square, square + np.array([1.0 + gap, 0.25])


def test_two_squares_overlap_as_deep_as_they_are_pushed_together() -> None:
    found = geometry.overlap(*_squares(-0.125))
    assert found is not None
    depth, place = found
    assert depth == pytest.approx(0.125, rel=1e-14)
    assert 0.375 - 1e-12 <= place[0] <= 0.5 + 1e-12


@pytest.mark.parametrize("gap", [0.0, 1e-12, 0.5])
def test_squares_that_touch_or_stay_apart_do_not_overlap(gap: float) -> None:
    assert geometry.overlap(*_squares(gap)) is None


def test_a_polygon_within_another_overlaps() -> None:
    outer, inner = np.array(geometry.rectangle(2.0, 2.0)), np.array(geometry.rectangle(0.5, 0.5)) + 0.1
    found = geometry.overlap(outer, inner)
    assert found is not None
    assert found[0] == pytest.approx(1.0 - 0.1 + 0.25, rel=1e-12)


@given(convex(), convex(), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_overlap_agrees_with_points_common_to_both(
    first: list[tuple[float, float]], second: list[tuple[float, float]], dx: float, dy: float
) -> None:
    a = geometry.counter_clockwise(first) - geometry.counter_clockwise(first).mean(axis=0)
    b = (
        geometry.counter_clockwise(second)
        - geometry.counter_clockwise(second).mean(axis=0)
        + [dx * 4, dy * 4]
    )
    found = geometry.overlap(a, b)
    mirrored = geometry.overlap(b, a)
    assert (found is None) == (mirrored is None)
    normals, offsets = zip(geometry.edges(a), geometry.edges(b), strict=True)
    normal, offset = np.vstack(normals), np.concatenate(offsets)
    # the point deepest in both: maximise t with offset - normal . q >= t
    best = linprog(
        [0.0, 0.0, -1.0],
        A_ub=np.column_stack([normal, np.ones(len(normal))]),
        b_ub=offset,
        bounds=[(None, None)] * 3,
    )
    inradius = -float(best.fun)
    if abs(inradius) > 1e-7:
        assert (found is not None) == (inradius > 0.0)
    if found is not None:
        assert found[0] >= 2.0 * inradius - 1e-9 or inradius < 1e-7
        assert mirrored is not None
        assert found[0] == pytest.approx(mirrored[0], rel=1e-9, abs=1e-12)
