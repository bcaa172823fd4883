"""Noise in linear time: each root, precision and innovation against dense matrices."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from kernel import gap_problem as case
from kernel.dense_noise import law_covariance
from kernel.gap_lines import readings
from oed.base.arrays import Array, Index
from oed.gap.cause.closure import RunNoise
from oed.gap.data import evidence
from oed.gap.data.laws import LawEvidence
from oed.gap.data.problem import GapProblem
from oed.noise.banded import ROWS, BandedFactor, ChainFactor
from oed.noise.law import NoiseLaw
from oed.noise.outliers import with_columns
from oed.noise.runs import Runs
from oed.noise.shared import SharedFactor
from oed.noise.stated import StatedErrors


def chains(
    size: int, channels: int, rng: np.random.Generator
) -> tuple[Index, Array, Array]:
    """The readings before, decays and fresh variances of interleaved chains."""
    before = np.maximum(np.arange(size) - channels, 0)
    before[:channels] = np.arange(min(channels, size))
    decay = rng.uniform(0.2, 0.99, size)
    decay[:channels] = 0.0
    return before, decay, 0.7 * (1.0 - decay**2)


def carried(before: Index, decay: Array, fresh: Array) -> Array:
    """Covariance (N, N) of what is carried, reading after reading."""
    differences = np.eye(len(decay))
    rows = np.flatnonzero(decay)
    differences[rows, before[rows]] -= decay[rows]
    inverse = np.linalg.inv(differences)
    return np.asarray(inverse @ np.diag(fresh) @ inverse.T)


@pytest.mark.parametrize(("size", "channels"), [(5, 1), (ROWS, 1), (99, 3), (98, 2)])
def test_a_banded_root_is_choleskys(
    size: int, channels: int, rng: np.random.Generator
) -> None:
    before, decay, fresh = chains(size, channels, rng)
    single = rng.uniform(0.1, 1.0, size)
    dense = np.diag(single) + carried(before, decay, fresh)
    factor, root = (
        BandedFactor(before, decay, single, fresh),
        np.linalg.cholesky(dense),
    )
    values = rng.standard_normal((size, 3))
    assert_allclose(factor.whiten(values), np.linalg.solve(root, values), atol=1e-12)
    assert_allclose(
        factor.whiten_back(values), np.linalg.solve(root.T, values), atol=1e-12
    )
    assert factor.log_det == pytest.approx(np.linalg.slogdet(dense)[1])
    assert_allclose(
        factor.precision_diagonal(), np.diag(np.linalg.inv(dense)), rtol=1e-10
    )


@pytest.mark.parametrize("size", [1, 2, 40])
def test_halves_of_chains_have_the_precisions_products(
    size: int, rng: np.random.Generator
) -> None:
    before, decay, fresh = chains(size, 1, rng)
    decay[:: size // 3 + 1] = 0.0  # several chains, one after the other
    single = rng.uniform(0.1, 1.0, size)
    dense = np.diag(single) + carried(before, decay, fresh)
    values = rng.standard_normal((size, 3))
    factor = ChainFactor(decay, single, fresh)
    differences, solved = factor.halves(values)
    assert_allclose(
        differences.T @ solved, values.T @ np.linalg.solve(dense, values), rtol=1e-9
    )
    log_det = np.linalg.slogdet(dense)[1]
    assert factor.log_variances.sum() == pytest.approx(log_det)
    with pytest.raises(np.linalg.LinAlgError):
        ChainFactor(np.full(2, 0.5), np.zeros(2), np.zeros(2))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_shared_errors_have_choleskys_root(
    sign: float, rng: np.random.Generator
) -> None:
    columns, starts = 0.2 * rng.standard_normal((30, 2)), np.array([0, 12])
    dense = np.eye(30)
    for part in (slice(0, 12), slice(12, 30)):
        dense[part, part] += sign * columns[part] @ columns[part].T
    values = rng.standard_normal((30, 3))
    white = SharedFactor(columns, starts, sign).whiten(values)
    assert_allclose(white, np.linalg.solve(np.linalg.cholesky(dense), values))


def stated_errors(problem: GapProblem, share: float) -> StatedErrors:
    """Stated errors: related channels, a share carried along, two errors of a run."""
    rng, size = np.random.default_rng(6), len(problem)
    channels = int(problem.channel.max()) + 1
    blocks = np.tril(rng.uniform(0.2, 0.5, (size // channels, channels, channels)))
    return StatedErrors(
        inverse=sparse.csr_array(sparse.block_diag(list(np.linalg.inv(blocks)))),
        carried=share,
        reach=3.0,
        place=problem.position,
        shared=rng.uniform(0.1, 0.5, (size, 2)),
    )


def dense_covariance(problem: Runs, law: NoiseLaw) -> Array:
    covariance = np.zeros((len(problem), len(problem)))
    for number, members in enumerate(problem.members):
        covariance[np.ix_(members, members)] = law_covariance(
            law, problem, problem.members[number]
        )
    return covariance


def problems() -> list[tuple[GapProblem, NoiseLaw]]:
    """Readings of one channel and of two, with laws of all that the model has."""
    several = []
    for problem in (case.circles(), readings(3)):
        size = len(problem)
        law = dataclasses.replace(
            case.law(problem), channel_ratio=1.0 + 0.5 * problem.channel
        )
        several.append((problem, law))
        assert size < 1000
    two, law = several[1]
    alone = dataclasses.replace(law, ar1_sd=0.0)
    several += [
        (dataclasses.replace(two, stated=stated_errors(two, 0.0)), law),
        (dataclasses.replace(two, stated=stated_errors(two, 0.0)), alone),
        (dataclasses.replace(two, stated=stated_errors(two, 0.4)), alone),
    ]
    return several


@pytest.mark.parametrize("number", range(5))
def test_a_law_is_whitened_as_its_covariance_is(
    number: int, rng: np.random.Generator
) -> None:
    problem, law = problems()[number]
    dense, factor = dense_covariance(problem, law), law.factor(problem)
    inverse, values = np.linalg.inv(dense), rng.standard_normal((len(problem), 3))
    white = factor.whiten(values)
    assert_allclose(white.T @ white, values.T @ inverse @ values, rtol=1e-9)
    assert factor.log_det == pytest.approx(np.linalg.slogdet(dense)[1])
    assert_allclose(factor.precision(values), inverse @ values, atol=1e-10)
    assert_allclose(factor.precision_diagonal(), np.diag(inverse), rtol=1e-9)


@pytest.mark.parametrize("number", range(5))
def test_what_is_held_out_is_predicted_as_by_dense_conditioning(
    number: int, rng: np.random.Generator
) -> None:
    """In squares: the innovations are whitened by the covariance of what is held out."""
    problem, law = problems()[number]
    dense, noise = dense_covariance(problem, law), RunNoise(problem, law)
    values = rng.standard_normal((len(problem), 2))
    reading = problem.rows.groupby(["setup", "run", "order"]).ngroup().to_numpy()
    some = rng.permutation(reading.max() + 1)[: reading.max() // 5]
    for held in (np.flatnonzero(np.isin(reading, some)), problem.members[1]):
        white = noise.hold_out(held).innovations(noise.score(values))
        others = np.setdiff1d(np.arange(len(problem)), held)
        cross = np.linalg.solve(
            dense[np.ix_(others, others)], dense[np.ix_(others, held)]
        )
        error = values[held] - cross.T @ values[others]
        spread = dense[np.ix_(held, held)] - dense[np.ix_(held, others)] @ cross
        expected = error.T @ np.linalg.solve(spread, error)
        assert_allclose(white.T @ white, expected, rtol=1e-9)


def test_laws_that_differ_in_what_runs_share_have_their_evidence(
    rng: np.random.Generator,
) -> None:
    for problem in (case.circles(), readings(3)):
        columns = rng.standard_normal((len(problem), 4))
        laws = []
        for share, run, seat in ((0.3, 0.5, 0.0), (0.3, 2.0, 0.7), (0.0, 0.0, 0.0)):
            law = NoiseLaw(run, np.sqrt(share), 4.0, 1.0 - share)
            ratio = 1.0 + run * problem.channel
            laws.append(dataclasses.replace(law, seat_sd=seat, channel_ratio=ratio))
        expected = [evidence.log_evidence(problem, law, columns) for law in laws]
        assert_allclose(LawEvidence(problem, columns)(laws), expected, rtol=1e-9)


def test_the_precision_with_columns_is_that_of_the_whole_covariance(
    rng: np.random.Generator,
) -> None:
    problem = case.circles()
    law, columns = case.law(problem), rng.standard_normal((len(problem), 6))
    dense = np.linalg.inv(dense_covariance(problem, law) + columns @ columns.T)
    precision = with_columns(law.factor(problem), columns)
    assert_allclose(precision.diagonal, np.diag(dense), rtol=1e-9)
    values = rng.standard_normal(len(problem))
    assert_allclose(precision.apply(values), dense @ values, atol=1e-10)


def test_the_memory_of_long_runs_is_that_of_their_readings(
    rng: np.random.Generator,
) -> None:
    """Four runs of 1250 readings: one dense matrix of a run has 12.5 MB."""
    size = 5000
    runs = Runs(
        stated=None,
        members=tuple(np.arange(size).reshape(4, -1)),
        position=np.tile(np.arange(size // 4, dtype=float), 4),
        channel=np.zeros(size, dtype=np.intp),
        seat=rng.standard_normal((size, 3)),
    )
    law = NoiseLaw(0.5, 0.6, 8.0, 0.64, seat_sd=0.3)
    values = rng.standard_normal((size, 4))
    tracemalloc.start()
    factor = law.factor(runs)
    factor.whiten(values)
    factor.precision(values)
    factor.precision_diagonal()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8e6
