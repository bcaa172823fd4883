"""Noise laws that the evidence of a hypothesis rests on: their number, and more of them."""

import numpy as np
import pytest
from scipy import special

from kernel.gap_lines import BOW, planted, readings
from kernel.laws import noise_law
from oed.gap.cause import searches as searching
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library


def _under(problem: GapProblem, run_sd: float, log_prior: float = 0.0) -> Search:
    law = noise_law(run_sd=run_sd)
    forms, none = library.build(problem, [BOW]), library.build(problem, ())
    return Search(problem, forms, none, law, log_prior)


def test_a_law_that_was_searched_needs_no_search_for_another_weight():
    problem = planted(readings(4), BOW, {"leg 1": 1.0}, turns=2.0)
    search = _under(problem, 0.3)
    search.run()
    weighed, anew = search.with_weight(-1.7), _under(problem, 0.3, -1.7)
    pairs = zip(weighed.run(), anew.run(), strict=True)
    assert [h.key for h in weighed.run()] == [h.key for h in anew.run()]
    for h, other in pairs:
        assert h.log_evidence == pytest.approx(other.log_evidence)
    refitted = weighed.fit(("bow",), (0,), (1.0,))
    assert refitted.log_evidence == pytest.approx(
        anew.fit(("bow",), (0,), (1.0,)).log_evidence
    )


def test_laws_are_drawn_where_a_likely_gap_rests_on_few():
    """Under laws one of which suits far better; not where all suit alike."""
    problem = planted(readings(4), BOW, {"leg 1": 2.0, "leg 2": -1.0}, turns=2.0)
    for sizes, count in (((0.0, 30.0, 100.0), 1), ((0.1,) * 4, 0)):
        several = [_under(problem, size) for size in sizes]
        best = compare(several)[0]
        assert best.effects == ("bow",)
        alike = [h for s in several for h in s.run() if h.key == best.key]
        shares = special.softmax([h.log_evidence for h in alike])
        assert best.effective_laws == pytest.approx(1.0 / (shares**2).sum())
        posteriors: dict = {}
        searching._add_scarce(posteriors, several)
        assert len(posteriors) == count


def test_a_law_in_a_corner_is_the_only_one(monkeypatch):
    """As where all rows are copies of others: no law is drawn about the mode."""
    problem = planted(readings(4), BOW, {"leg 1": 1.0}, turns=2.0)
    monkeypatch.setattr(evidence, "MAX_COORDINATE", 0.0)
    posterior = evidence.posterior(problem, evidence.compress(problem))
    assert np.isfinite(posterior.log_evidence)
    assert (posterior.draws == posterior.draws[0]).all()
