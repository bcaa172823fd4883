"""What is said of residuals that the stated noise does not explain."""

from types import SimpleNamespace
from typing import Any

import pytest

from oed.estimation.estimate import large_residuals


def estimate(ratio: float, posterior: object = None) -> Any:
    return SimpleNamespace(
        chi2=40.0 * ratio**2, dof=40.0, noise_posterior=posterior, law_check=None
    )


@pytest.mark.parametrize(("ratio", "posterior", "words"), [
    (1.2, None, None),
    (3.0, None, "repeat readings on the spot: what scatters there is noise"),
    (3.0, "known", "the intervals are as wide as the residuals ask for"),
    (11.0, None, "or the readings have a mistake"),
])  # fmt: skip
def test_the_remedy_follows_from_how_large_they_are(ratio, posterior, words):
    sentences = large_residuals(estimate(ratio, posterior))
    if words is None:
        assert sentences == []
        return
    (sentence,) = sentences
    assert words in sentence
    assert f"{ratio:.1f} times the stated noise" in sentence
