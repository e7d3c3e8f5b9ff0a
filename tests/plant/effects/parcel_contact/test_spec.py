"""The settings of ``parcel_contact``: what they are without a word, and what is refused."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects


def test_an_empty_table_resolves_contacts_without_bounce_friction_or_rails() -> None:
    spec = PlantEffects.model_validate({"parcel_contact": {}}).parcel_contact
    assert spec is not None
    assert (spec.mode, spec.restitution, spec.friction, spec.rails) == ("resolved", 0.0, 0.0, ())


@pytest.mark.parametrize(
    ("rail", "rule"),
    [
        ([[0.0, 0.0]], "at least 3 corners"),
        ([[0.0, 0.0], [0.0, 0.0]], "both ends are the same point"),
        ([[0.0, 0.0], [1.0, 0.0], [0.2, 0.2], [0.0, 1.0]], "corner 2 is not convex"),
    ],
)
def test_a_rail_that_is_no_segment_and_no_convex_polygon_is_refused_by_number(
    rail: list[list[float]], rule: str
) -> None:
    with pytest.raises(ValidationError, match=f"rail 1: .*{rule}"):
        ParcelContactSpec.model_validate({"rails": [[[0.0, 0.0], [1.0, 0.0]], rail]})


@pytest.mark.parametrize(
    "values",
    [{"restitution": 1.1}, {"restitution": -0.1}, {"friction": -1.0}, {"step_s": 0.0}, {"mode": "off"}],
)
def test_values_out_of_range_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match=next(iter(values))):
        ParcelContactSpec.model_validate(values)
