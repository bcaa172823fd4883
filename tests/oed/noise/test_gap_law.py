"""The law of a diagnosis in words."""

from kernel.laws import noise_law


def test_a_law_in_words_names_each_part_that_is_large():
    law = noise_law(level=2.0, seat_sd=0.8)
    assert [words for words in law.describe() if "seats anew" in words] == [
        "what a run seats anew, such as a cup on its magnet, repeats to 1.6 times the"
        " stated noise"
    ]
    assert len(law.describe()) == 2
    assert len(noise_law(level=2.0, seat_sd=0.1).describe()) == 1
