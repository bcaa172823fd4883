"""Numbers and names as messages say them."""

import pytest

from oed import text, units


@pytest.mark.parametrize(("share", "words"), [
    (0.0, "0 %"), (0.0004, "under 0.1 %"), (0.004, "0.4 %"), (0.834, "83 %"),
    (0.9962, "99.6 %"), (0.9996, "over 99.9 %"), (1.0, "100 %"),
])  # fmt: skip
def test_nothing_and_all_are_never_rounded_to(share, words):
    assert text.percent(share) == words


@pytest.mark.parametrize(("value", "digits", "words"), [
    (1234.0, 2, "1200"), (9.6, 1, "10"), (-2345.6, 3, "-2350"), (0.0312, 2, "0.031"),
])  # fmt: skip
def test_rounded_numbers_have_no_exponent(value, digits, words):
    assert text.rounded(value, digits) == words


def test_what_is_guaranteed_is_rounded_down():
    assert text.guaranteed_percent(0.9996) == 99.9
    assert text.guaranteed_percent(0.3) == 30.0


def test_a_long_text_is_shortened_to_one_printable_line():
    assert text.shorten("two\nlines\x07", 20) == "two lines"
    assert text.shorten("a" * 8, 8) == "a" * 8
    assert text.shorten("a" * 9, 8) == "aaaa ..."


def test_an_unknown_name_gets_the_nearest_and_the_list():
    known = ["radius", "arm", "angle"]
    near = text.suggest("radios", known)
    assert near == "did you mean radius? (allowed: radius, arm, angle)"
    assert text.suggest("zzz", known, "open", limit=2) == "open: radius, arm, ..."
    assert text.suggest("x", []) == "nothing is allowed here: remove it"


def test_a_quantity_has_three_digits_of_its_fine_unit():
    assert units.quantity(12.345e-6, "m") == "12.3 um"
