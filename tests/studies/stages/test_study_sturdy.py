"""Robust plans and the number of readings, against values computed in the test."""

from __future__ import annotations

import itertools

import design_sample as small
import numpy as np
import pytest

from pkm_studies.base import InputError

ROBUST = (
    'criterion = "I"\n' + small.KNOWN + 'robust = { risk = "worst", scenarios = 6 }\n'
)
MANY = (
    'criterion = "I"\n'
    + small.KNOWN
    + "how_many = { readings = [2, 4, 6], most = 8 }\n"
)


def best_accuracy(
    resolved: small.Resolved, design: small.Chosen, size: int
) -> dict[str, float]:
    """Least predicted rms of each component, SI, of all plans of `size` candidates, by
    plain linear algebra.
    """
    m, maps = resolved.measurement, design.criteria.error_maps
    whitened = small.rows(resolved)
    plans = np.array(list(itertools.combinations(range(len(whitened)), size)))
    rows = whitened[plans]
    information = np.eye(rows.shape[2]) + np.swapaxes(rows, 1, 2) @ rows
    every_slope = np.zeros((*maps.raw.shape[:2], len(m.names)))
    every_slope[:, :, : maps.raw.shape[2]] = maps.raw
    slopes = (every_slope * m.tolerance)[:, :, m.free]
    covariance = np.linalg.inv(information)
    products = np.einsum("nkp,nkq->kpq", slopes, slopes) / len(slopes)
    variance = np.einsum("kpq,cpq->ck", products, covariance).min(axis=0)
    return dict(zip(maps.names, np.sqrt(variance), strict=True))


def test_a_robust_plan_is_never_worse_than_the_nominal_one_and_below_its_bound():
    resolved, design = small.chosen(small.text(ROBUST))
    robust = design.robust
    assert len(robust.values) == 6
    assert robust.value == pytest.approx(min(robust.values))
    assert robust.nominal == pytest.approx(min(robust.nominal_values))
    assert robust.nominal - 1e-8 <= robust.value <= robust.bound
    # the first scenario is the nominal machine: log phi = -log of the summed variance
    # there
    rows = small.rows(resolved)[design.choice.indices]
    gradients = design.criteria.ingredient("I", resolved.measurement)
    wanted = gradients.reshape(-1, gradients.shape[2]) / np.sqrt(len(gradients))
    covariance = np.linalg.inv(np.eye(rows.shape[1]) + rows.T @ rows)
    assert robust.values[0] == pytest.approx(
        -np.log(np.trace(wanted @ covariance @ wanted.T)), abs=1e-9
    )
    assert (
        "6 machines drawn from the tolerances" in small.section(resolved, design).words
    )


def test_accuracy_against_the_number_of_readings():
    """No pair of readings is more accurate than the bound, and the curve falls."""
    resolved, design = small.chosen(small.text(MANY))
    curve = design.how_many
    assert curve.sizes == [2, 4, 6]
    pairs = best_accuracy(resolved, design, 2)
    for name, unit, key in (("x", 1e-6, "x_um"), ("z", 1e-6, "z_um")):
        best = pairs[name] / unit
        assert curve.bound[key][0] <= best * (1 + 1e-9)
        assert curve.accuracy[key][0] >= best * (1 - 1e-9)
        assert (np.diff(curve.bound[key]) < 0).all()
        assert curve.accuracy[key][2] < curve.accuracy[key][0]


@pytest.mark.slow
def test_the_fewest_readings_for_a_wanted_accuracy():
    resolved, design = small.chosen(small.text(MANY))
    best = {n: best_accuracy(resolved, design, n)["z"] for n in (3, 4)}
    wanted = 1e6 * 0.5 * (best[3] + best[4])  # four can, three cannot
    changed = MANY.replace("most = 8", f"most = 8, wanted = {{ z_um = {wanted:.6f} }}")
    _, design = small.chosen(small.text(changed))
    assert design.how_many.fewest == 4
    assert design.how_many.at_least <= 4
    _, unreachable = small.chosen(
        small.text(MANY.replace("most = 8", "most = 8, wanted = { z_um = 0.001 }"))
    )
    assert unreachable.how_many.fewest is None
    assert "no plan of that size can" in unreachable.how_many.words


@pytest.mark.parametrize(("design", "words"), [
    ("robust = {}\n", "not all drawn machines see"),
    ("how_many = {}\n", "accuracy depends on the tolerances"),
    ('criterion = "E"\n' + small.KNOWN + "robust = { scenarios = 2 }\n", "a smooth criterion"),
    (small.KNOWN + "how_many = { wanted = { w_um = 3 } }\n", "w_um"),
    (small.KNOWN + 'robust = { risk = "hope" }\n', "risk"),
])  # fmt: skip
def test_what_cannot_be_computed_is_refused(design, words):
    with pytest.raises(InputError, match=words):
        small.chosen(small.text(design))
