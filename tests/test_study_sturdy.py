"""Robust plans and the number of readings, from a study file to its result, against
values computed anew.
"""

from __future__ import annotations

import itertools

import design_sample as small
import numpy as np
import pytest

from pkm_studies.errors import InputError

ROBUST = (
    'criterion = "I"\n' + small.KNOWN + 'robust = { risk = "worst", scenarios = 6 }\n'
)
MANY = (
    'criterion = "I"\n'
    + small.KNOWN
    + "how_many = { readings = [2, 4, 6], most = 8 }\n"
)


def accuracy(
    resolved: small.Resolved, found: small.Chosen, rows: np.ndarray
) -> dict[str, float]:
    """Predicted rms of each component, SI, from whitened rows, by plain linear algebra."""
    m, maps = resolved.measurement, found.criteria.error_maps
    assert maps is not None
    free = m.free
    covariance = np.linalg.inv(np.eye(int(free.sum())) + rows.T @ rows)
    wide = np.zeros((*maps.raw.shape[:2], len(m.names)))
    wide[:, :, : maps.raw.shape[2]] = maps.raw
    slopes = (wide * m.tolerance)[:, :, free]
    told = np.einsum("nkp,pq,nkq->k", slopes, covariance, slopes) / len(slopes)
    return dict(zip(maps.names, np.sqrt(told), strict=True))


def test_a_robust_plan_is_never_worse_than_the_nominal_one_and_below_its_bound() -> (
    None
):
    resolved, found = small.chosen(small.text(ROBUST))
    told = found.robust
    assert told is not None
    assert len(told.values) == 6
    assert told.value == pytest.approx(min(told.values))
    assert told.nominal == pytest.approx(min(told.nominal_values))
    assert told.nominal - 1e-8 <= told.value <= told.bound
    # the first scenario is the nominal machine: log phi = -log of the summed variance
    # there
    rows = small.rows(resolved)[found.choice.indices]
    wanted = found.criteria.ingredients("I", resolved.measurement)["factor"]
    covariance = np.linalg.inv(np.eye(rows.shape[1]) + rows.T @ rows)
    assert told.values[0] == pytest.approx(
        -np.log(np.trace(wanted @ covariance @ wanted.T)), abs=1e-9
    )
    assert (
        "6 machines drawn from the tolerances" in small.section(resolved, found).words
    )


def test_accuracy_against_the_number_of_readings() -> None:
    """No two readings of all pairs are more accurate than the bound, and the curve
    falls.
    """
    resolved, found = small.chosen(small.text(MANY))
    told = found.how_many
    assert told is not None
    assert told.sizes == [2, 4, 6]
    rows = small.rows(resolved)
    pairs = [
        accuracy(resolved, found, rows[list(p)])
        for p in itertools.combinations(range(len(rows)), 2)
    ]
    for name, unit, key in (("x", 1e-6, "x_um"), ("z", 1e-6, "z_um")):
        best = min(p[name] for p in pairs) / unit
        assert told.bound[key][0] <= best * (1 + 1e-9)
        assert told.accuracy[key][0] >= best * (1 - 1e-9)
        assert (np.diff(told.bound[key]) < 0).all()
        assert told.accuracy[key][2] < told.accuracy[key][0]


def test_the_fewest_readings_for_a_wanted_accuracy() -> None:
    resolved, found = small.chosen(small.text(MANY))
    rows = small.rows(resolved)
    best = {
        n: min(
            accuracy(resolved, found, rows[list(p)])["z"]
            for p in itertools.combinations(range(len(rows)), n)
        )
        for n in (3, 4)
    }
    wanted = 1e6 * 0.5 * (best[3] + best[4])  # four can, three cannot
    asked = MANY.replace("most = 8", f"most = 8, wanted = {{ z_um = {wanted:.6f} }}")
    _, found = small.chosen(small.text(asked))
    assert found.how_many is not None
    assert found.how_many.fewest == 4
    assert found.how_many.at_least <= 4
    _, never = small.chosen(
        small.text(MANY.replace("most = 8", "most = 8, wanted = { z_um = 0.001 }"))
    )
    assert never.how_many is not None
    assert never.how_many.fewest is None
    assert "no plan of that size can" in never.how_many.words


@pytest.mark.parametrize(
    ("design", "told"),
    [
        ("robust = {}\n", "not all drawn machines see"),
        ("how_many = {}\n", "accuracy depends on the tolerances"),
        (
            'criterion = "E"\n' + small.KNOWN + "robust = { scenarios = 2 }\n",
            "a smooth criterion",
        ),
        (small.KNOWN + "how_many = { wanted = { w_um = 3 } }\n", "w_um"),
        (small.KNOWN + 'robust = { risk = "hope" }\n', "risk"),
    ],
)
def test_what_cannot_be_asked_is_said(design: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        small.chosen(small.text(design))
