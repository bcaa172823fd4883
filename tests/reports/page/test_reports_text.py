"""Numbers, units, shares, lists and combinations as text of a report."""

import pytest

from pkm_reports import text


@pytest.mark.parametrize(("value", "written"), [
    (0.0, "0"),
    (None, "–"),
    (float("nan"), "–"),
    (float("inf"), "∞"),
    (3748.2, "3748"),
    (0.00124, "0.00124"),
    (-58.684, "−58.7"),
    (9.996, "10.0"),
    (18, "18"),
    (3.2e-7, "3.2×10⁻⁷"),
    (1e-9, "10⁻⁹"),
])  # fmt: skip
def test_numbers_as_a_person_writes_them(value, written):
    assert text.number(value) == written


def test_units_and_shares():
    assert text.heading("z_mm") == "z [mm]"
    assert text.heading("theta_deg") == "theta [°]"
    assert text.heading("order") == "order"
    assert text.quantity(5.2, "um") == "5.20\N{NO-BREAK SPACE}µm"
    assert text.named_quantity("psi_deg", 30.0) == "psi\N{NO-BREAK SPACE}30°"
    assert text.split_unit("psi_arcsec") == ("psi", "arcsec")
    assert text.split_unit("no_unit") == ("no unit", "")
    assert text.percent(0.9767) == "98\N{NO-BREAK SPACE}%"
    assert text.percent(0.99999) == "over 99.9\N{NO-BREAK SPACE}%"
    assert text.percent(-0.12) == "−12\N{NO-BREAK SPACE}%"
    assert text.percent(-0.004) == "0\N{NO-BREAK SPACE}%"
    assert text.percent(None) == "–"
    assert text.percent_at_least(0.99999) == "99.9\N{NO-BREAK SPACE}%"
    assert text.percent_at_least(0.973) == "97.3\N{NO-BREAK SPACE}%"
    assert text.times(3.046) == "3.05×"


def test_decimals():
    assert text.trimmed(0.5) == "0.5"
    assert text.trimmed(1000.0) == "1000"
    assert text.fixed(-0.0001, 2) == "0.00"
    aligned = text.aligned([0.0, 24.0, None, 33.8908])
    assert aligned == ["0.0000", "24.0000", "–", "33.8908"]


def test_lists_and_combinations():
    assert text.listing(["a", "b", "c"]) == "a, b and c"
    combination = text.linear_combination({"a": -0.5, "b": 1.0})
    assert combination == "b − 0.5\N{NO-BREAK SPACE}a"


@pytest.mark.parametrize(("words", "sentence"), [
    ("runs differ by a third", "Runs differ by a third."),
    ("noise is as stated", "Noise is as stated."),
    ("x is lost", "x is lost."),
])  # fmt: skip
def test_a_sentence_starts_with_a_capital_but_not_with_that_of_a_symbol(
    words, sentence
):
    assert text.sentence(words) == sentence
