"""Units: every factor against pint."""

import numpy as np
import pint
import pytest

from oed import units

PINT = {
    "um": "micrometer", "C": "delta_degC", "1": "dimensionless", "h": "hour",
    "min": "minute", "deg": "degree",
}  # fmt: skip
SI = {"m": "m", "rad": "rad", "s": "s", "N": "N", "K": "kelvin", "1": "dimensionless"}


@pytest.fixture(scope="module")
def registry() -> pint.UnitRegistry:
    return pint.UnitRegistry()


@pytest.mark.parametrize("unit", units.UNITS)
def test_factors_agree_with_pint(registry, unit):
    quantity = registry.Quantity(1.0, PINT.get(unit, unit))
    there = quantity.to(SI[units.si_unit(unit)]).magnitude
    assert units.factor(unit) == pytest.approx(there, rel=1e-15)
    assert units.to_si([2.0, -3.0], unit) == pytest.approx(
        np.array([2.0, -3.0]) * there, rel=1e-15
    )
    assert units.from_si(units.to_si(0.7, unit), unit) == pytest.approx(0.7, rel=1e-15)


@pytest.mark.parametrize("table", [units.DISPLAY, units.FINE])
def test_what_is_displayed_measures_the_same_quantity(table):
    assert set(table) == set(SI)
    assert all(units.si_unit(shown) == si for si, shown in table.items())
    assert all(units.display(si) == shown for si, shown in units.DISPLAY.items())


def test_the_unit_is_split_off_a_name():
    assert units.split("sigma_um") == ("sigma", "um")
    assert units.split("read_x_mm") == ("read_x", "mm")
    assert units.split("temp_frame_C") == ("temp_frame", "C")


@pytest.mark.parametrize(
    "name", ["sigma", "sigma_", "_um", "um", "sigma_inch", "sigma_UM", ""]
)
def test_a_name_without_a_known_unit_is_refused(name):
    with pytest.raises(
        units.UnitError, match=r"carries no known unit; end it in one of .*arcsec.*mm"
    ):
        units.split(name)


def test_an_unknown_unit_is_refused_with_the_known_ones():
    for use in (units.factor, units.si_unit, lambda unit: units.to_si(1.0, unit)):
        with pytest.raises(
            units.UnitError, match=r"unknown unit 'inch'; known are .*mm"
        ):
            use("inch")
