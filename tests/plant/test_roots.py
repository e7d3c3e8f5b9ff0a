"""Isolated roots against exact arithmetic: Sturm sequences on fractions."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from plant.kernels.common import roots

Coefficients = list[float]


@njit
def _compiled(g, order, end, p):  # type: ignore[no-untyped-def]
    return roots.first_crossing(g, order, end, p)


def first(g: Coefficients, upward: bool, end: float = 1.0) -> float:
    """What the kernel, which looks for falls, finds."""
    falling = np.array(g, dtype=np.float64) * (-1.0 if upward else 1.0)
    return float(_compiled(falling, len(g) - 1, end, np.zeros(len(g))))


def _value(p: list[Fraction], t: Fraction) -> Fraction:
    total = Fraction(0)
    for c in reversed(p):
        total = total * t + c
    return total


def _sturm(p: list[Fraction]) -> list[list[Fraction]]:
    chain = [p, [k * c for k, c in enumerate(p)][1:]]
    while len(chain[-1]) > 1:
        a, b = list(chain[-2]), chain[-1]
        while len(a) >= len(b):
            factor = a[-1] / b[-1]
            shift = len(a) - len(b)
            a = [c - (factor * b[k - shift] if k >= shift else 0) for k, c in enumerate(a)][:-1]
            while a and a[-1] == 0:
                a.pop()
        if not a:
            break
        chain.append([-c / abs(a[-1]) for c in a])
    return chain


def _variations(chain: list[list[Fraction]], t: Fraction) -> int:
    signs = [value > 0 for p in chain if (value := _value(p, t)) != 0]
    return sum(a != b for a, b in pairwise(signs))


def crossings(g: Coefficients, end: float = 1.0) -> list[tuple[float, int]]:
    """Every change of sign of ``g`` in (0, end]: where, and +1 or -1, exactly."""
    p = [Fraction(c) for c in g]
    while p and p[-1] == 0:
        p.pop()
    if len(p) < 2:
        return []
    chain = _sturm(p)
    found: list[tuple[float, int]] = []

    def split(low: Fraction, high: Fraction, count: int) -> None:
        if count == 0:
            return
        if high - low < Fraction(1, 2**46):
            before, after = _value(p, low), _value(p, high)
            if (before < 0 <= after) or (before >= 0 > after):
                found.append((float(high), 1 if after >= 0 else -1))
            return
        middle = (low + high) / 2
        while _value(p, middle) == 0:
            middle += (high - low) / 1000
        left = _variations(chain, low) - _variations(chain, middle)
        split(low, middle, left)
        split(middle, high, count - left)

    last = Fraction(end) + Fraction(1, 2**70)
    low = Fraction(1, 2**80)
    if _value(p, low) == 0 or _value(p, last) == 0:
        return []
    split(low, last, _variations(chain, low) - _variations(chain, last))
    return found


def _product(factors: list[list[float]]) -> Coefficients:
    """Coefficients of a product, computed exactly and rounded once."""
    total = [Fraction(1)]
    for factor in factors:
        exact = [Fraction(c) for c in factor]
        grown = [Fraction(0)] * (len(total) + len(exact) - 1)
        for i, a in enumerate(total):
            for j, b in enumerate(exact):
                grown[i + j] += a * b
        total = grown
    return [float(c) for c in total]


def _shallow(g: Coefficients, start: float, stop: float) -> bool:
    """Whether ``g`` stays within rounding of zero between two points."""
    size = sum(abs(c) for c in g)
    p = [Fraction(c) for c in g]
    between = [Fraction(start) + (Fraction(stop) - Fraction(start)) * k / 16 for k in range(17)]
    return max(abs(float(_value(p, t))) for t in between) <= 1e-13 * size


def _distinct(g: Coefficients, end: float) -> list[tuple[float, int]]:
    """The crossings of ``g`` without those before which, or the pairs between which, it is zero to rounding."""
    found: list[tuple[float, int]] = []
    for t, direction in crossings(g, end):
        if found and (t - found[-1][0] < 2.0**-33 or _shallow(g, found[-1][0], t)):
            found.pop()
        elif not found and _shallow(g, 0.0, t):
            continue  # no sign to change: rounding so far
        else:
            found.append((t, direction))
    return found


def _check(g: Coefficients, upward: bool, end: float = 1.0) -> None:
    """The kernel's answer is the first crossing, save for touches no deeper than rounding."""
    found = first(g, upward, end)
    want = [t for t, direction in _distinct(g, end) if (direction > 0) == upward]
    if found != roots.NONE:
        assert 0.0 <= found <= end
        assert _shallow(g, found, found), "no root lies there"
    if want:
        assert found <= want[0] or _shallow(g, want[0], min(found, 1.0)), (g, want, found)


def test_the_oracle_itself_finds_known_roots() -> None:
    g = _product([[-0.25, 1.0], [-0.5, 1.0], [-0.75, 1.0]])
    assert [(round(t, 12), s) for t, s in crossings(g)] == [(0.25, 1), (0.5, -1), (0.75, 1)]


@pytest.mark.parametrize("upward", [True, False])
def test_the_first_of_several_roots_in_the_requested_direction_is_found(upward: bool) -> None:
    g = _product([[-0.25, 1.0], [-0.5, 1.0], [-0.75, 1.0]])
    assert first(g, upward) == pytest.approx(0.25 if upward else 0.5, abs=1e-15)


@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize("place", [0.01, 0.337, 0.5, 0.999])
def test_two_crossings_within_one_step_are_both_seen(gap: float, place: float) -> None:
    g = _product([[-place, 1.0], [-(place + gap), 1.0], [2.0, 1.0]])
    if place + gap < 1.0:
        assert first(g, False) == pytest.approx(place, abs=1e-8 * max(1.0, 1e-7 / gap))
        assert first(g, True) == pytest.approx(place + gap, abs=1e-8 * max(1.0, 1e-7 / gap))


def test_a_touch_from_above_or_below_is_no_crossing_and_hides_no_later_one() -> None:
    touch = _product([[-0.5, 1.0], [-0.5, 1.0]])
    assert first([c + (1e-12 if k == 0 else 0.0) for k, c in enumerate(touch)], False) == roots.NONE
    later = _product([[-0.25, 1.0], [-0.25, 1.0], [0.75, -1.0]])
    later[0] += 1e-12
    assert first(later, False) == pytest.approx(0.75, abs=1e-9)


def test_a_triple_root_is_a_crossing() -> None:
    g = _product([[-0.3, 1.0]] * 3)
    assert first(g, True) == pytest.approx(0.3, abs=1e-4)


def test_nothing_is_found_past_the_requested_end() -> None:
    g = [-0.5, 1.0]
    assert first(g, True, 0.4999) == roots.NONE
    assert first(g, True, 0.5001) == pytest.approx(0.5, abs=1e-15)


@pytest.mark.parametrize("value", [0.0, 1.0, -1.0])
def test_constants_cross_nothing(value: float) -> None:
    assert first([value, 0.0, 0.0], True) == roots.NONE
    assert first([value, 0.0, 0.0], False) == roots.NONE


@pytest.mark.parametrize("tiny", [1e-30, -1e-30, 5e-324])
def test_a_tiny_leading_coefficient_changes_nothing(tiny: float) -> None:
    assert first([-0.25, 1.0, 0.0, 0.0, tiny], True) == pytest.approx(0.25, abs=1e-15)


def test_the_scale_of_the_polynomial_does_not_matter() -> None:
    g = _product([[-0.25, 1.0], [-0.2500001, 1.0], [-0.9, 1.0]])
    for scale in (1e-200, 1e-20, 1e200):
        assert first([c * scale for c in g], True) == pytest.approx(0.25, abs=1e-8)
        # a test of signs by their product would find the start of the interval that it underflows in
        assert first([-0.3 * scale, scale], True) == pytest.approx(0.3, abs=1e-15)


def test_numpy_agrees_on_random_polynomials_of_high_order() -> None:
    draw = np.random.default_rng(7)
    compared = 0
    for _ in range(1500):
        order = int(draw.integers(1, 23))
        g = draw.normal(size=order + 1) * 0.5 ** np.arange(order + 1)
        real = [r.real for r in np.roots(g[::-1]) if abs(r.imag) < 1e-12 and 1e-6 < r.real < 1.0 - 1e-6]
        rising = sorted(r for r in real if np.polyval(np.polyder(g[::-1]), r) > 0.0)
        found = first(list(g), True)
        if rising:
            assert found == pytest.approx(rising[0], abs=1e-9)
            compared += 1
        else:
            assert found == roots.NONE or found > 1.0 - 1e-6 or found < 1e-6
    assert compared > 100


@settings(max_examples=40)
@given(
    st.lists(st.floats(0.001, 1.2), min_size=1, max_size=4),
    st.lists(st.tuples(st.floats(-1.0, 2.0), st.floats(0.0, 1.0)), max_size=2),
    st.integers(1, 3),
    st.booleans(),
)
def test_the_first_crossing_is_exact_for_clustered_and_multiple_roots(
    real: list[float], pairs: list[tuple[float, float]], repeat: int, upward: bool
) -> None:
    factors = [[-r, 1.0] for r in real] + [[-real[0], 1.0]] * (repeat - 1)
    factors += [[a * a + b * b, -2.0 * a, 1.0] for a, b in pairs]
    _check(_product(factors), upward)


@settings(max_examples=40)
@given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=8), st.booleans(), st.floats(0.05, 1.0))
def test_the_first_crossing_is_exact_for_any_coefficients(g: Coefficients, upward: bool, end: float) -> None:
    if g[0] != 0.0:
        _check(g, upward, end)
