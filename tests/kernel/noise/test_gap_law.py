"""The noise's covariance by its parts: runs of one length at once, their channels apart
where these are independent.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import sparse

from kernel import gap_problem as case
from kernel.dense_noise import dense_covariance, law_covariance
from kernel.gap_lines import readings
from oed.gap.data.metric import Metric
from oed.measurement.reading_structure import reading_structure
from oed.noise.law import NoiseLaw, describe, law_of
from oed.noise.process import Laws
from oed.noise.stated import StatedErrors

LAW = NoiseLaw(0.7, 0.9, 6.0, level=1.3, channel_ratio=np.ones(1), seat_sd=0.4)


@pytest.mark.parametrize("related", [False, True])
def test_whitened_by_channels_is_whitened_by_the_whole(related: bool) -> None:
    problem, rng = readings(3), np.random.default_rng(3)
    size = len(problem)
    # a stated error of a run keeps its channels together
    one = sparse.csr_array(sparse.eye_array(size))
    wide = StatedErrors(
        inverse=one / np.sqrt(0.6),
        carried=0.0,
        reach=1.0,
        place=problem.position,
        shared=np.sqrt(0.4) * np.ones((size, 1)),
    )
    problem = dataclasses.replace(problem, stated=wide if related else None)
    # and each run seats two unknowns anew
    problem = dataclasses.replace(problem, seat=rng.standard_normal((size, 2)))
    law = dataclasses.replace(
        LAW, variance=1.7, channel_ratio=1.0 + 0.5 * problem.channel
    )
    dense = np.zeros((size, size))
    for k, members in enumerate(problem.members):
        dense[np.ix_(members, members)] = law_covariance(
            law, problem, problem.members[k]
        )
    factor, values = law.factor(problem), rng.standard_normal((size, 3))
    assert factor.log_det == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-9)
    white = factor.whiten(values)
    assert white.T @ white == pytest.approx(
        values.T @ np.linalg.solve(dense, values), rel=1e-9
    )
    geometry = dense + problem.slopes @ problem.slopes.T
    assert Metric(problem, law).gram(values, values) == pytest.approx(
        values.T @ np.linalg.solve(geometry, values), rel=1e-6, abs=1e-6
    )
    segments = np.split(problem.layout.order, problem.layout.starts[1:])
    assert {len(members) for members in segments} == {
        len(problem.members[0]) // (1 if related else 2)
    }


def test_a_law_of_the_noise_model_has_the_same_covariance_run_by_run() -> None:
    """Against the covariance that the estimate of the parameters uses."""
    problem = case.circles()
    structure = reading_structure(problem.measurement, problem.series, problem.theta)
    laws = Laws(*(np.array(v) for v in ([[1.4]], [0.3], [6.0], [0.8], [1.7])))
    law, covariance = law_of(laws, 0, problem.channel), np.zeros((len(problem),) * 2)
    for k, members in enumerate(problem.members):
        covariance[np.ix_(members, members)] = law_covariance(
            law, problem, problem.members[k]
        )
    assert problem.seat.any()
    np.testing.assert_allclose(covariance, dense_covariance(structure, laws), atol=1e-9)


def test_a_law_in_words_names_each_part_that_is_large() -> None:
    law = NoiseLaw(0.0, 0.0, 1.0, level=2.0, seat_sd=0.8)
    assert [words for words in describe(law) if "seats anew" in words] == [
        "what a run seats anew, such as a cup on its magnet, repeats to 1.6 times the"
        " stated noise"
    ]
    assert len(describe(law)) == 2
    assert len(describe(dataclasses.replace(law, seat_sd=0.1))) == 1
