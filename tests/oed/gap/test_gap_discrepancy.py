"""The discrepancy's kernels, priors and covariates."""

import dataclasses

import numpy as np
import pytest

from kernel import gap_problem
from kernel.gap_lines import BOW, readings
from oed.gap.forms import discrepancy
from oed.gap.forms import library as libraries


@pytest.mark.parametrize("reach", [0.3, 1.0])
def test_modes_have_the_kernel(reach):
    places = np.random.default_rng(4).integers(-99, 99, (30, 2, 2)) / 100.0
    modes = discrepancy.modes(places, reach, 60)
    flat = places.reshape(-1, 2)
    distance = np.linalg.norm(flat[:, None] - flat, axis=-1)
    factor = modes.reshape(len(flat), -1)
    scaled = np.sqrt(3.0) * distance / reach  # Matern's correlation of order 3/2
    remainder = (1.0 + scaled) * np.exp(-scaled) - factor @ factor.T
    assert np.linalg.eigvalsh(remainder).min() > -1e-9
    assert np.trace(remainder) <= (1.0 - discrepancy.VARIANCE_SHARE) * len(flat) + 1e-9
    few = discrepancy.modes(places, reach, 5)
    np.testing.assert_allclose(few, modes[:, :, :5])


@pytest.mark.parametrize("problem", [readings(3), gap_problem.circles(passes=2)])
def test_forms_of_a_kind_share_its_prior(problem):
    library = discrepancy.build(problem)
    assert np.isfinite(library.columns.all()).all()
    for kind in library.effects:
        shares = [np.exp(library.atoms[k].log_weight) for k in library.atoms_of(kind)]
        assert sum(shares) == pytest.approx(1.0)


def test_kinds_come_under_the_conditions_of_listed_effects():
    """Of five effects three need nothing, one the time; the last cannot be tested."""
    problem = readings(3)
    named = ("", "", "", "time: 3 or temp_leg", "payload")
    needs = [(need,) if need else () for need in named]
    effects = [
        dataclasses.replace(BOW, name=f"bow {k}", needs=n) for k, n in enumerate(needs)
    ]
    listed = libraries.build(problem, effects)
    terms = discrepancy.build(problem)
    logs = discrepancy.log_shares(terms, listed)
    shares = {a.effect: np.exp(p) for a, p in zip(terms.atoms, logs, strict=True)}
    counts = {"over the workspace": 4, "over time": 2}
    total = len(shares) + 4
    assert sum(shares.values()) == pytest.approx(1.0)
    for kind, share in shares.items():
        assert share == pytest.approx(counts.get(kind, 1) / total)


def test_units_of_length_change_nothing():
    """Readings, noise and slopes in millimetres, as of a machine 1000 times as large."""
    problem = readings(3)
    scaled = dataclasses.replace(problem, sigma=1e3 * problem.sigma)
    for library in (discrepancy.build(problem), discrepancy.build(scaled)):
        sizes = np.linalg.norm(library.columns.all(), axis=0)
        assert 0.01 < np.median(sizes) / np.sqrt(len(problem)) < 1.0
    one, other = (discrepancy.build(p).columns.all() for p in (scaled, problem))
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_what_was_not_recorded_or_did_not_change_is_no_term():
    problem = readings(3)
    kinds = set(discrepancy.build(problem).effects)
    assert {"over time", "with the direction", "with the feed"} <= kinds
    assert "with the payload" not in kinds
    unknown = np.full(len(problem.states[0]), np.nan)
    states = tuple(dataclasses.replace(s, feed=unknown) for s in problem.states)
    less = dataclasses.replace(problem, states=states)
    assert set(discrepancy.build(less).effects) == kinds - {"with the feed"}


def test_a_joint_or_a_set_up_may_err_alone():
    library = discrepancy.build(readings(3))
    alone = {
        frozenset(library.labels[c] for c in atom.columns)
        for atom in library.atoms
        if atom.effect == "over time"
    }
    assert frozenset({"leg 2"}) in alone
    assert frozenset({"channel dy in lines"}) in alone
    assert frozenset({"leg 1", "leg 2"}) in alone
