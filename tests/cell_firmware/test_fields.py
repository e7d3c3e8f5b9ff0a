from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from cell_firmware.fields import Field, FieldSpec

FIELD: TypeAdapter[Field] = TypeAdapter(FieldSpec)


def at(spec: dict[str, Any], *points: tuple[float, float]) -> NDArray[np.float64]:
    x, y = np.array(points, dtype=np.float64).T
    return FIELD.validate_python(spec).velocity(x, y)


@pytest.mark.parametrize(
    ("spec", "point", "velocity"),
    [
        ({"kind": "uniform", "velocity_m_s": [0.1, -0.2]}, (7.0, 9.0), (0.1, -0.2)),
        ({"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0}, (0.5, 0.25), (-0.5, -0.5)),
        (
            {"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0, "centre_m": [0.25, 1.25]},
            (0.5, 0.25),
            (-0.25, 2.0),
        ),
        ({"kind": "squeeze", "speed_m_s": 0.3}, (0.01, 5.0), (-0.3, 0.0)),
        ({"kind": "squeeze", "speed_m_s": 0.3}, (-4.0, 5.0), (0.3, 0.0)),
        ({"kind": "squeeze", "speed_m_s": 0.3}, (0.0, 5.0), (0.0, 0.0)),
        ({"kind": "squeeze", "speed_m_s": 0.3, "axis": "y"}, (4.0, 5.0), (0.0, -0.3)),
        ({"kind": "squeeze", "speed_m_s": 0.3, "axis": "y", "centre_m": [0, 6]}, (4.0, 5.0), (0.0, 0.3)),
        ({"kind": "radial", "rate_per_s": -2.0}, (0.3, 0.4), (-0.6, -0.8)),
        ({"kind": "radial", "speed_m_s": 5.0}, (0.3, 0.4), (3.0, 4.0)),
        ({"kind": "radial", "speed_m_s": 5.0}, (0.0, 0.0), (0.0, 0.0)),
        ({"kind": "radial", "speed_m_s": 5.0, "rotation_rad_s": 10.0}, (0.3, 0.4), (-1.0, 7.0)),
        ({"kind": "vortex", "rate_rad_s": 2.0}, (0.3, 0.4), (-0.8, 0.6)),
        ({"kind": "vortex", "speed_m_s": 5.0}, (0.3, 0.4), (-4.0, 3.0)),
        ({"kind": "vortex", "speed_m_s": 5.0, "centre_m": [0.3, 0.4]}, (0.3, 0.4), (0.0, 0.0)),
    ],
)
def test_a_field_has_the_velocity_worked_out_by_hand(
    spec: dict[str, Any], point: tuple[float, float], velocity: tuple[float, float]
):
    np.testing.assert_allclose(at(spec, point), [velocity], rtol=1e-15, atol=1e-16)


def test_a_sum_adds_its_fields_and_sums_nest():
    conveyor = {"kind": "uniform", "velocity_m_s": [0.125, 0.0]}
    centring = {"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0}
    nested = {"kind": "sum", "fields": [conveyor, {"kind": "sum", "fields": [centring, conveyor]}]}
    np.testing.assert_array_equal(at(nested, (0.5, 0.25)), [(-0.25, -0.5)])


def test_two_squeezes_centre_along_both_axes():
    both = {
        "kind": "sum",
        "fields": [{"kind": "squeeze", "speed_m_s": 0.3, "axis": axis} for axis in ("x", "y")],
    }
    np.testing.assert_array_equal(at(both, (1.0, -1.0), (-1.0, 1.0)), [(-0.3, 0.3), (0.3, -0.3)])


number = st.floats(-10, 10, allow_subnormal=False)
linear = st.one_of(
    st.builds(lambda a, b: {"kind": "elliptic", "kx_per_s": a, "ky_per_s": b}, number, number),
    st.builds(lambda a, b: {"kind": "radial", "rate_per_s": a, "rotation_rad_s": b}, number, number),
    st.builds(lambda a: {"kind": "vortex", "rate_rad_s": a}, number),
)
field = st.one_of(
    linear,
    st.builds(lambda a, b: {"kind": "uniform", "velocity_m_s": [a, b]}, number, number),
    st.builds(lambda a, c: {"kind": "radial", "speed_m_s": a, "centre_m": [c, a]}, number, number),
    st.builds(lambda a, c: {"kind": "vortex", "speed_m_s": a, "centre_m": [c, a]}, number, number),
    st.builds(
        lambda a, axis: {"kind": "squeeze", "speed_m_s": a, "axis": axis}, number, st.sampled_from("xy")
    ),
)


@given(linear, number, number, number, number)
def test_fields_given_by_rates_are_linear_in_position(
    spec: dict[str, Any], ax: float, ay: float, bx: float, by: float
):
    a, b, total = at(spec, (ax, ay), (bx, by), (ax + 2 * bx, ay + 2 * by))
    np.testing.assert_allclose(total, a + 2 * b, rtol=1e-12, atol=1e-12)


@given(field, number, number)
def test_a_field_is_linear_in_its_strength(spec: dict[str, Any], x: float, y: float):
    strengths = {"kx_per_s", "ky_per_s", "rate_per_s", "rotation_rad_s", "rate_rad_s", "speed_m_s"}
    doubled = {key: 2 * value if key in strengths else value for key, value in spec.items()}
    if "velocity_m_s" in spec:
        doubled["velocity_m_s"] = [2 * value for value in spec["velocity_m_s"]]
    # to the bit, but where numbers are so small that they lose bits
    np.testing.assert_allclose(at(doubled, (x, y)), 2 * at(spec, (x, y)), rtol=0.0, atol=1e-300)


@given(field, st.lists(st.tuples(number, number), min_size=1, max_size=40))
def test_a_cell_alone_gets_the_same_bits_as_among_many(
    spec: dict[str, Any], points: list[tuple[float, float]]
):
    together = at({"kind": "sum", "fields": [spec, spec]}, *points)
    alone = np.concatenate([at({"kind": "sum", "fields": [spec, spec]}, point) for point in points])
    assert together.tobytes() == alone.tobytes()


@pytest.mark.parametrize("kind", ["radial", "vortex"])
@pytest.mark.parametrize("both", [True, False])
def test_speed_and_rate_exclude_each_other_and_one_is_needed(kind: str, both: bool):
    rate = "rate_per_s" if kind == "radial" else "rate_rad_s"
    given_values = {rate: 1.0, "speed_m_s": 1.0} if both else {}
    with pytest.raises(ValidationError, match=f"give {rate} or speed_m_s, one of the two"):
        FIELD.validate_python({"kind": kind, **given_values})


def test_a_sum_of_nothing_is_refused():
    with pytest.raises(ValidationError, match="at least one field"):
        FIELD.validate_python({"kind": "sum", "fields": []})


def test_fields_refuse_what_is_not_a_number():
    with pytest.raises(ValidationError, match="finite"):
        FIELD.validate_python({"kind": "elliptic", "kx_per_s": float("nan"), "ky_per_s": 1.0})
