import contextlib
import gc
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.fields import Field, FieldSpec
from cell_firmware.fields.formula import Formula, FormulaError
from cell_firmware.protocols.velocity_field import VelocityField, VelocityFieldParameters

FIELD: TypeAdapter[Field] = TypeAdapter(FieldSpec)
Floats = NDArray[np.float64]


def expression(vx: str, vy: str = "0", **constants: float) -> Field:
    return FIELD.validate_python({"kind": "expression", "vx": vx, "vy": vy, "constants": constants})


def scattered(n: int, seed: int = 7) -> tuple[Floats, Floats]:
    x, y = np.random.default_rng(seed).uniform(-2.0, 2.0, (2, n))
    x[0] = y[0] = 0.0
    return x, y


# --- what a formula comes to ------------------------------------------------------------------------


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """No collection of garbage meanwhile: where many modules are loaded it takes longer than what is timed."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@pytest.mark.parametrize(
    ("text", "at", "value"),
    [
        ("-0.5*x + 0.1*sin(3*y)", (0.4, 0.0), -0.2),
        ("-x**2", (3.0, 0.0), -9.0),
        ("2 - 3 - 4", (0.0, 0.0), -5.0),
        ("2 / 4 / 2", (0.0, 0.0), 0.25),
        ("x**0", (0.0, 0.0), 1.0),
        ("  x\n + y ", (1.0, 2.0), 3.0),
        ("min(x, y, 1) + 10*max(x, y, 1)", (3.0, 2.0), 31.0),
        ("where(0 < x <= 1 and not y == 2, 5, 7)", (1.0, 2.0), 7.0),
        ("where(0 < x <= 1 or y == 2, 5, 7)", (4.0, 2.0), 5.0),
        ("where(x > 0, 1/x, 0)", (0.0, 0.0), 0.0),
        ("sign(x) * k", (-0.1, 0.0), -0.3),
        ("hypot(x, y) + abs(x)", (-3.0, 4.0), 8.0),
        ("atan2(y, x)", (0.0, 1.0), math.pi / 2),
    ],
)
def test_a_formula_comes_to_what_it_says(text: str, at: tuple[float, float], value: float):
    found = expression(text, k=0.3).velocity(np.array([at[0]]), np.array([at[1]]))
    np.testing.assert_allclose(found, [[value, 0.0]], rtol=1e-15, atol=1e-16)


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        (name, getattr(math, name))
        for name in ("sin", "cos", "tan", "atan2", "exp", "log", "tanh", "hypot", "sqrt")
    ],
)
def test_a_function_is_the_one_of_its_name_to_two_units_in_the_last_place(
    name: str, reference: Callable[..., float]
):
    x, y = scattered(500)
    x = abs(x) + 0.01
    two = name in ("atan2", "hypot")
    found = Formula(f"{name}(x, y)" if two else f"{name}(x)", {})(x, y)
    wanted = np.array([reference(a, b) if two else reference(a) for a, b in zip(x, y, strict=True)])
    assert (abs(found - wanted) <= 2.0 * np.spacing(abs(wanted))).all()


@pytest.mark.parametrize(
    ("bundled", "vx", "vy"),
    [
        (
            {"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0, "centre_m": [0.3, -0.1]},
            "-1*(x - 0.3)",
            "-2*(y + 0.1)",
        ),
        ({"kind": "squeeze", "speed_m_s": 0.3}, "-0.3*sign(x)", "0"),
        ({"kind": "radial", "speed_m_s": 0.5}, "0.5*(x/R)", "0.5*(y/R)"),
        ({"kind": "radial", "rate_per_s": -2.0, "rotation_rad_s": 0.7}, "-2*x - 0.7*y", "-2*y + 0.7*x"),
        ({"kind": "vortex", "rate_rad_s": 0.7}, "-0.7*y", "0.7*x"),
        ({"kind": "vortex", "speed_m_s": 0.7}, "-0.7*(y/R)", "0.7*(x/R)"),
        ({"kind": "uniform", "velocity_m_s": [0.1, -0.2]}, "0.1", "-0.2"),
    ],
)
def test_a_bundled_field_written_as_a_formula_is_the_same_field(bundled: dict[str, Any], vx: str, vy: str):
    x, y = scattered(300)
    radius = "where(x == 0 and y == 0, 1, sqrt(x*x + y*y))"
    found = expression(vx.replace("R", radius), vy.replace("R", radius)).velocity(x, y)
    np.testing.assert_array_equal(found, FIELD.validate_python(bundled).velocity(x, y))


def _alone(function: Callable[..., Any]) -> Callable[..., np.float64]:
    return lambda *values: function(*(np.array([value]) for value in values))[0]


def _power(base: np.float64, exponent: int) -> np.float64:
    found = np.float64(1.0)
    for _ in range(exponent):
        found = found * base
    return found


_PYTHON = {
    "F": np.float64,
    "power": _power,
    "least": lambda a, b: a if a <= b or np.isnan(a) else b,
    "sin": _alone(np.sin),
    "exp": _alone(np.exp),
    "atan2": _alone(np.arctan2),
    "sqrt": np.sqrt,
}
"""What Python's own evaluation of the second text needs."""

_leaves = st.one_of(
    st.sampled_from([("x", "x"), ("y", "y"), ("k", "F(0.3)"), ("pi", f"F({math.pi!r})")]),
    st.floats(0, 9).map(lambda v: (repr(v), f"F({v!r})")),
)


def _larger(parts: st.SearchStrategy[tuple[str, str]]) -> st.SearchStrategy[tuple[str, str]]:
    def binary(a: tuple[str, str], sign: str, b: tuple[str, str]) -> tuple[str, str]:
        return f"({a[0]}) {sign} ({b[0]})", f"({a[1]}) {sign} ({b[1]})"

    def call(name: str, a: tuple[str, str]) -> tuple[str, str]:
        return f"{name}({a[0]})", f"{name}({a[1]})"

    def choice(a: Any, order: str, b: Any, c: Any) -> tuple[str, str]:
        return (
            f"where({a[0]} {order} {b[0]}, {c[0]}, {a[0]})",
            f"({c[1]} if {a[1]} {order} {b[1]} else {a[1]})",
        )

    return st.one_of(
        st.builds(binary, parts, st.sampled_from("+-*/"), parts),
        st.builds(call, st.sampled_from(["sin", "exp", "sqrt", "-"]), parts),
        st.builds(lambda a, b: (f"atan2({a[0]}, {b[0]})", f"atan2({a[1]}, {b[1]})"), parts, parts),
        st.builds(lambda a, b: (f"min({a[0]}, {b[0]})", f"least({a[1]}, {b[1]})"), parts, parts),
        st.builds(lambda a, n: (f"({a[0]})**{n}", f"power({a[1]}, {n})"), parts, st.integers(0, 16)),
        st.builds(choice, parts, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), parts, parts),
    )


@given(st.recursive(_leaves, _larger, max_leaves=12))
def test_any_formula_comes_to_what_python_makes_of_it(texts: tuple[str, str]):
    """To the bit, functions being those of NumPy for a single number; ``eval`` reads what the generator wrote."""
    ours, python = texts
    if len(ours) > 1_000:
        return
    x, y = scattered(5)
    found = Formula(ours, {"k": 0.3})(x, y)
    with np.errstate(all="ignore"):
        wanted = [eval(python, {**_PYTHON, "x": a, "y": b}) for a, b in zip(x, y, strict=True)]
    np.testing.assert_array_equal(found, np.array(wanted, dtype=np.float64))


EVERYTHING = (
    "where(x < y, sin(3*x)*cos(y)/tan(x), atan2(y, x)) + exp(x)*log(abs(y) + 0.1) - tanh(x*y)*hypot(x, y)"
    " + sqrt(abs(x))*x**5 + max(x, y, 0)*min(0*x, -0*y)"
)


def test_a_cell_gets_the_same_bits_alone_among_thousands_and_wherever_it_is_in_memory():
    x, y = scattered(3001)
    field = expression(EVERYTHING, f"x - ({EVERYTHING})")
    together = field.velocity(x, y)
    for begin, end in ((0, 3000), (1, 3001), (2, 9), (3, 20), (1500, 1533)):
        part = field.velocity(x[begin:end], y[begin:end])
        assert part.tobytes() == together[begin:end].tobytes()
    for i in (*range(40), *range(2960, 3001)):
        assert field.velocity(x[i : i + 1].copy(), y[i : i + 1].copy()).tobytes() == together[i].tobytes()


# --- what is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "column", "rule"),
    [
        ("-0.5*x + z", 10, "unknown name 'z'; known: x, y, pi, k"),
        ("foo(x)", 1, "unknown function 'foo'"),
        ("__import__(x)", 1, "unknown function '__import__'"),
        ("x + sin", 5, "sin is a function: its arguments are missing"),
        ("sin(x, y)", 1, "arguments of sin: must be 1, not 2"),
        ("min(x)", 1, "arguments of min: must be 2 or more, not 1"),
        ("where(x > 0, 1)", 1, "arguments of where: must be 3, not 2"),
        ("where(x, 1, 2)", 7, "must be a condition"),
        ("x > 0", 1, "a condition stands only at the first place of where"),
        ("x.real", 1, "must be a number, a name"),
        ("sin.__class__(x)", 1, "must be a number, a name"),
        ("lambda: x", 7, "no formula has the character ':'"),
        ("x if y else 1", 1, "must be a number, a name"),
        ("x // y", 1, "must be a number, a name"),
        ("exp(x=y)", 1, "must be a number, a name"),
        ("sin(*x)", 5, "must be a number, a name"),
        ("9**9**9", 4, "an exponent must be a whole number, 0 to 16"),
        ("x**17", 4, "an exponent must be a whole number, 0 to 16"),
        ("x**-1", 4, "an exponent must be a whole number, 0 to 16"),
        ("x**y", 4, "an exponent must be a whole number, 0 to 16"),
        ("1e999", 1, "must be a finite number"),
        ("9" * 999, 1, "must be a finite number"),
        ("1j", 1, "must be a real number, not 1j"),
        ("True", 1, "must be a real number, not True"),
        ("x +", 4, "can't be read"),
        (") + (", 1, "can't be read"),
        ("1or 2", 1, "can't be read"),
        ("x; y", 2, "no formula has the character ';'"),
        ("x[0]", 2, "no formula has the character '['"),
        ("'a'", 1, 'no formula has the character "\'"'),
        ("2*х", 3, "no formula has the character"),  # noqa: RUF001 - a Cyrillic letter
        ("x\x00", 2, "no formula has the character"),
        ("  q", 3, "unknown name 'q'"),
        ("(" * 900, 201, "can't be read: too many nested parentheses"),
        ("-" * 999 + "x", 101, "must not be nested deeper than 100 parts"),
        ("+".join("x" * 400), 1, "must not be nested deeper than 100 parts"),
        ("sin(" * 190 + "x" + ")" * 190, 401, "must not be nested deeper than 100 parts"),
    ],
)
def test_a_formula_is_refused_fast_with_the_column_and_the_rule(text: str, column: int, rule: str):
    with uncollected():
        begun = time.process_time()
        with pytest.raises(FormulaError) as caught:
            Formula(text, {"k": 1.0})
        assert time.process_time() - begun < 0.02
    first, shown, caret = str(caught.value).split("\n")
    assert first.startswith(f"column {column}: {rule}")
    assert shown[caret.index("^") : caret.index("^") + 1] in (text[column - 1 : column], "", " ")


@pytest.mark.parametrize(
    ("text", "rule"),
    [("", "must not be empty"), (" \n", "must not be empty"), ("x" * 10_000_000, "at most 1000 characters")],
)
def test_a_formula_of_no_use_is_refused_at_once(text: str, rule: str):
    with uncollected():
        begun = time.process_time()
        with pytest.raises(FormulaError, match=rule):
            Formula(text, {})
        assert time.process_time() - begun < 0.02


@given(st.text(max_size=60))
def test_whatever_text_there_is_it_is_a_formula_or_refused(text: str):
    try:
        found = Formula(text, {})(np.ones(2), np.ones(2))
    except FormulaError:
        return
    assert found.shape == (2,)


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("x", "x has a meaning already"),
        ("sin", "sin has a meaning"),
        ("2a", "'2a' is not a name"),
        ("é", "not a name"),
    ],
)
def test_a_constant_that_no_formula_could_name_is_refused(name: str, rule: str):
    with pytest.raises(ValidationError, match=rule):
        expression("1", **{name: 2.0})


def test_the_error_names_the_formula_it_is_in():
    with pytest.raises(ValidationError) as caught:
        expression("x", "2*q")
    assert caught.value.errors()[0]["loc"] == ("expression", "vy")


def test_a_field_that_is_no_number_at_a_cell_is_refused_before_the_run():
    lattice = Lattice([(0, 0), (0, 1), (0, 2)])
    position = np.array([[-0.1, 0.5], [0.0, 0.5], [0.1, 0.5]])
    nested = {"kind": "sum", "fields": [{"kind": "expression", "vx": "y", "vy": "1/x"}]}
    firmware = VelocityField(VelocityFieldParameters.model_validate({"field": nested}))
    with pytest.raises(ParametersError) as caught:
        firmware.check_geometry(lattice, position, 0.1)
    (problem,) = caught.value.problems
    assert problem.path == ("field",)
    assert problem.message == "is (0.5, inf) m/s at cell [0, 1], x = 0, y = 0.5: must be finite"
    firmware.check_geometry(Lattice([(0, 0), (0, 2)]), position[[0, 2]], 0.1)
