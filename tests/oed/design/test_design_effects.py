"""Designs that allow for effects: against dense covariances and all subsets."""

import itertools

import msgspec
import numpy as np
import pytest
import report_fixture
from design_sample import EXTRA, KNOWN, chosen, rows, text
from result_sample import whole

from oed.design import Candidates, Nuisances, choose
from oed.result import AllowedEffects
from pkm_studies.base import InputError
from pkm_studies.stages.headline import design_sentences

EFFECTS = 'effects = ["encoder_scale", "pitch_accumulation"]\n'


def dense(h, g, scatter, subset):
    """Information of rows, with effects and scatter as a covariance, in noise units."""
    covariance = np.diag(1.0 + scatter[subset] ** 2) + g[subset] @ g[subset].T
    return h[subset].T @ np.linalg.solve(covariance, h[subset]) + np.eye(h.shape[1])


@pytest.mark.parametrize("name", ["D", "A"])
def test_no_subset_is_better_nor_above_the_bound(name):
    """All 56 choices of 3 readings out of 8, with drawn effects."""
    rng = np.random.default_rng(3)
    resolved, _ = chosen(text('criterion = "D"\n' + KNOWN + EXTRA))
    measurement, series = resolved.measurement, resolved.candidates
    h, sigma = rows(resolved), 0.5e-6
    g, scatter = 20.0 * rng.standard_normal((8, 3)), 5.0 * rng.random(8)
    nuisances = Nuisances(sigma * g, sigma * scatter)
    m, prior = measurement, np.eye(h.shape[1])
    pool = Candidates.build(m, series, m.nominal, "tolerance", nuisances=nuisances)
    pool = pool.add_prior(prior)
    assert pool.nuisance_columns == 3
    choice = choose(
        pool.blocks, 3, np.random.default_rng(0), pool.criterion(name), prior=pool.prior
    )
    values = {}
    for subset in itertools.combinations(range(8), 3):
        inverse = np.linalg.inv(dense(h, g, scatter, list(subset)))
        if name == "D":
            values[subset] = -float(np.linalg.slogdet(inverse)[1])
        else:
            values[subset] = -float(np.log(np.trace(inverse)))
    best = max(values, key=lambda subset: values[subset])
    assert tuple(choice.indices) == best
    assert choice.efficiency is not None
    assert 0.0 < choice.efficiency <= 1.0 + 1e-9


def test_the_plan_is_stated_beside_that_without_effects():
    """By I, no plan of three readings leaves less on a machine with the effects."""
    _, design = chosen(text('criterion = "I"\n' + KNOWN + EXTRA + EFFECTS))
    allowed = design.effects
    assert allowed.groups > 3
    assert 0.0 < allowed.efficiency <= 1.0 + 1e-9
    assert 0.0 < allowed.efficiency_without <= 1.0 + 1e-9
    for key, value in allowed.accuracy.items():
        assert value < allowed.before[key]
    resolved, rigid = chosen(text('criterion = "I"\n' + KNOWN + EXTRA))
    assert rigid.effects is None
    predicted = rigid.criteria.predicted_accuracy(resolved.measurement, rigid.series)
    # effects leave more than the geometry alone
    assert all(allowed.accuracy_without[k] > v for k, v in predicted.items())


def test_reference_plans_are_compared_without_effects():
    """Values with and without effects are not set against each other."""
    section = report_fixture.result_of(whole()).design
    assert section is not None
    plans = [
        msgspec.structs.replace(section.plans[0], name=name, criterion="I", value=value)
        for name, value in (("chosen", -2e-8), ("paper", -3e-8))
    ]
    allowed = AllowedEffects(2, 3, 0.9, 1.0, {}, {}, {})
    found = {"criterion": "I", "value": -4e-7, "efficiency": 0.97, "proven": False}
    section = msgspec.structs.replace(section, plans=plans, effects=allowed, **found)
    (words,) = design_sentences(section)
    assert (
        "reach I = -4e-07 with effects (certified to 97.0 % of the best possible), and"
        " without any I = -2e-08, against -3e-08 for paper"
    ) in words
    (alone,) = design_sentences(msgspec.structs.replace(section, effects=None))
    assert "without" not in alone


@pytest.mark.parametrize(("lines", "words"), [
    ('criterion = "D"\nreadings = 3\n', 'need scaling = "tolerance"'),
    ('criterion = "E"\n' + KNOWN, "does not profile out effects"),
    ('criterion = "D"\nhow_many = {}\n' + KNOWN, "accuracy by number of readings"),
])  # fmt: skip
def test_what_cannot_allow_for_effects_is_refused(lines, words):
    with pytest.raises(InputError, match=words):
        chosen(text(lines + EXTRA + EFFECTS))
