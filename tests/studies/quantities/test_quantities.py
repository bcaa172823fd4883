"""Numbers with their unit in the key: SI values, or a refusal with the units that fit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oed import units
from pkm_studies import quantities
from pkm_studies.base import InputError, Location

HERE = Location("x.study.toml")
#: no longer than a field's, as messages are shortened
name = st.from_regex(r"[a-z]{1,12}[0-9]?(_[xyz])?", fullmatch=True)


@given(name=name, unit=st.sampled_from(sorted(units.UNITS)), value=st.floats(-1e6, 1e6))
def test_a_key_gives_its_value_in_si(name, unit, value):
    values = quantities.read_values(
        {f"{name}_{unit}": value}, {name: units.si_unit(unit)}, HERE
    )
    assert values == {name: pytest.approx(value * units.factor(unit), rel=1e-15)}


@given(
    name=name,
    unit=st.sampled_from(sorted(units.UNITS)),
    kind=st.sampled_from(sorted(units.DISPLAY)),
)
def test_a_unit_of_another_kind_is_refused_with_those_that_fit(name, unit, kind):
    if units.si_unit(unit) == kind:
        return
    with pytest.raises(InputError) as error:
        quantities.read_values({f"{name}_{unit}": 1.0}, {name: kind}, HERE)
    for allowed in quantities.allowed_units(kind):
        assert f"{name}_{allowed}" in str(error.value)


@pytest.mark.parametrize(("key", "words"), [
    ("length", "unit is missing in the name"),
    ("length_kg", '"kg" is no unit for length'),
    ("lenght_mm", "did you mean length_mm"),
    ("length_deg", "length_um"),
])  # fmt: skip
def test_a_key_that_fits_nothing(key, words):
    with pytest.raises(InputError, match=words):
        quantities.read_values({key: 1.0}, {"length": "m"}, HERE)


def test_a_quantity_given_twice_is_refused():
    with pytest.raises(InputError, match="given twice"):
        quantities.read_values(
            {"length_mm": 1.0, "length_um": 1.0}, {"length": "m"}, HERE
        )
