"""Noise in linear time: each root, precision and innovation against dense matrices."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg, sparse

from kernel import gap_problem as case
from kernel.gap_lines import readings
from kernel.laws import law_covariance, noise_law
from oed.base import Array
from oed.gap import GapProblem
from oed.gap.data import evidence
from oed.gap.data.evidence import linear_model, log_evidences
from oed.noise import Laws, NoiseLaw, NoiseStatement, ReadingStructure, SharedError
from oed.noise.banded import BLOCK_ROWS, ChainFactor, SharedFactor


def chains(size: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Decays and fresh variances of several chains, one after the other."""
    decay = rng.uniform(0.2, 0.99, size)
    decay[:: size // 3 + 1] = 0.0
    return decay, 0.7 * (1.0 - decay**2)


def carried(decay: Array, fresh: Array) -> Array:
    """Covariance (N, N) of what is carried, reading after reading."""
    inverse = np.linalg.inv(np.eye(len(decay)) - np.diag(decay[1:], k=-1))
    return np.asarray(inverse @ np.diag(fresh) @ inverse.T)


@pytest.mark.parametrize("size", [1, 2, 5, BLOCK_ROWS, 98, 99])
def test_a_root_of_chains_is_choleskys(size, rng):
    decay, fresh = chains(size, rng)
    single = rng.uniform(0.1, 1.0, size)
    dense = np.diag(single) + carried(decay, fresh)
    factor, root = ChainFactor(decay, single, fresh), np.linalg.cholesky(dense)
    values = rng.standard_normal((size, 3))
    assert_allclose(factor.whiten(values), np.linalg.solve(root, values), atol=1e-12)
    assert_allclose(factor.unwhiten(values), root @ values, atol=1e-12)
    assert_allclose(
        factor.whiten_back(values), np.linalg.solve(root.T, values), atol=1e-12
    )
    inverse = np.linalg.inv(dense)
    assert_allclose(factor.precision_diagonal(), np.diag(inverse), rtol=1e-10)
    white = factor.whiten(values)
    assert_allclose(white.T @ white, values.T @ inverse @ values, rtol=1e-9)
    log_det = np.linalg.slogdet(dense)[1]
    assert factor.log_variances.sum() == pytest.approx(log_det)
    with pytest.raises(np.linalg.LinAlgError):
        ChainFactor(np.full(size, 0.5), np.zeros(size), np.zeros(size))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_shared_errors_have_choleskys_root(sign, rng):
    columns, starts = 0.2 * rng.standard_normal((30, 2)), np.array([0, 12])
    dense = np.eye(30)
    for part in (slice(0, 12), slice(12, 30)):
        dense[part, part] += sign * columns[part] @ columns[part].T
    values = rng.standard_normal((30, 3))
    white = SharedFactor(columns, starts, sign).whiten(values)
    assert_allclose(white, np.linalg.solve(np.linalg.cholesky(dense), values))


def with_stated_errors(problem: GapProblem, share: float) -> GapProblem:
    """Related channels, a share that is carried along, two errors of a run."""
    rng, size = np.random.default_rng(6), len(problem)
    channels = int(problem.channel.max()) + 1
    blocks = np.tril(rng.uniform(0.2, 0.5, (size // channels, channels, channels)))
    whole, structure = linalg.block_diag(*np.linalg.inv(blocks)), problem.structure
    structure = dataclasses.replace(
        structure,
        decouple=sparse.csr_array(whole),
        columns=np.hstack([structure.columns, rng.uniform(0.1, 0.5, (size, 2))]),
        kinds=np.append(structure.kinds, [SharedError.KNOWN, SharedError.KNOWN]),
        statement=NoiseStatement(correlated=share, reach=3.0),
    )
    return dataclasses.replace(problem, structure=structure)


def dense_covariance(problem: GapProblem, law: NoiseLaw) -> Array:
    covariance = np.zeros((len(problem), len(problem)))
    for members in problem.members:
        covariance[np.ix_(members, members)] = law_covariance(law, problem, members)
    return covariance


def problems() -> list[tuple[GapProblem, NoiseLaw]]:
    """Readings of one channel and of two, with laws of all that the model has."""
    one, two = case.circles(), readings(3)
    law = noise_law(0.7, 0.9, 5.0, 1.2, level=1.3, seat_sd=0.6, ratios=(1.0, 1.5))
    alone = noise_law(0.7, variance=1.2, seat_sd=0.6, ratios=(1.0, 1.5))
    related = with_stated_errors(two, 0.4)
    alike = [(one, law), (two, law)]
    return [*alike, (related, law), (related, alone), (related, related.stated_law)]


@pytest.mark.parametrize("number", range(5))
def test_a_law_is_whitened_as_its_covariance_is(number, rng):
    problem, law = problems()[number]
    dense, factor = dense_covariance(problem, law), law.factor(problem.structure)
    inverse, values = np.linalg.inv(dense), rng.standard_normal((len(problem), 3))
    white = factor.whiten(values)
    assert_allclose(white.T @ white, values.T @ inverse @ values, rtol=1e-9)
    assert factor.log_det == pytest.approx(np.linalg.slogdet(dense)[1])
    assert_allclose(factor.precision(values), inverse @ values, atol=1e-10)
    assert_allclose(factor.precision_diagonal(), np.diag(inverse), rtol=1e-9)


@pytest.mark.parametrize("number", range(5))
def test_what_is_held_out_is_predicted_as_by_dense_conditioning(number, rng):
    """In squares: the innovations are whitened by the covariance of what is held out."""
    problem, law = problems()[number]
    dense, factor = dense_covariance(problem, law), law.factor(problem.structure)
    values = rng.standard_normal((len(problem), 2))
    reading = problem.rows.groupby(["setup", "run", "order"]).ngroup().to_numpy()
    some = rng.permutation(reading.max() + 1)[: reading.max() // 5]
    for held in (np.flatnonzero(np.isin(reading, some)), problem.members[1]):
        scored = factor.scored(factor.errors.standardise(values))
        white = factor.hold_out(held).innovations(scored)
        others = np.setdiff1d(np.arange(len(problem)), held)
        cross = np.linalg.solve(
            dense[np.ix_(others, others)], dense[np.ix_(others, held)]
        )
        error = values[held] - cross.T @ values[others]
        spread = dense[np.ix_(held, held)] - dense[np.ix_(held, others)] @ cross
        expected = error.T @ np.linalg.solve(spread, error)
        assert_allclose(white.T @ white, expected, rtol=1e-9)


def test_laws_that_differ_in_what_runs_share_have_their_evidence(rng):
    two = readings(3)
    for problem in (case.circles(), two, with_stated_errors(two, 0.4)):
        columns = rng.standard_normal((len(problem), 4))
        groups = problem.channel.max() + 1
        laws = Laws(
            scale=np.array([[1.0, 1.5], [1.0, 3.0], [1.0, 1.0]])[:, :groups],
            correlated=np.array([0.3, 0.3, 0.0]),
            reach=np.full(3, 4.0),
            level=np.array([0.5, 2.0, 0.0]),
            seat=np.array([0.0, 0.7, 0.0]),
        )
        every = [NoiseLaw(laws.take([k])) for k in range(3)]
        expected = [evidence.log_evidence(problem, law, columns) for law in every]
        assert_allclose(
            log_evidences(linear_model(problem, columns), laws), expected, rtol=1e-9
        )


def test_the_precision_with_columns_is_that_of_the_whole_covariance(rng):
    problem = case.circles()
    law, columns = case.law(problem), rng.standard_normal((len(problem), 6))
    dense = np.linalg.inv(dense_covariance(problem, law) + columns @ columns.T)
    factor = law.factor(problem.structure).widened(columns)
    assert_allclose(factor.precision_diagonal(), np.diag(dense), rtol=1e-9)
    values = rng.standard_normal((len(problem), 2))
    assert_allclose(factor.precision(values), dense @ values, atol=1e-10)


@pytest.mark.parametrize("alike", [False, True], ids=["each its pair", "one pair"])
def test_many_channels_take_no_more_memory_than_their_products(alike, rng):
    """Products of each channel under each law would take nine times the memory."""
    runs, channels, length, columns = 6, 9, 5, 60
    chain = np.repeat(np.arange(runs * channels), length)
    structure = ReadingStructure(
        names=tuple(map(str, range(channels))),
        group=chain % channels,
        chain=chain,
        run=np.repeat(np.arange(runs), channels),
        position=np.tile(np.arange(length, dtype=float), runs * channels),
        unit=np.ones(len(chain)),
        decouple=None,
        columns=rng.standard_normal((len(chain), 2)),
        kinds=np.array([SharedError.LEVEL, SharedError.RENEWED]),
        course=rng.standard_normal((len(chain), 2)),
    )
    reach, level, seat, course = rng.uniform(0.5, 2.0, (4, 120))
    reach, scale = (
        np.ones(120) if alike else reach,
        rng.uniform(0.5, 2.0, (120, channels)),
    )
    laws = Laws(scale, np.full(120, 0.4), reach, level=level, seat=seat, course=course)
    values = rng.standard_normal((len(chain), columns))
    tracemalloc.start()
    gram = laws.whitening(structure).gram(values)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8.0 * gram.nbytes
    same_run = structure.run[chain][:, None] == structure.run[chain]
    for k in (0, 119):
        distance = np.abs(structure.position[:, None] - structure.position)
        carried_along = np.exp(-distance / laws.reach[k])
        dense = np.where(chain[:, None] == chain, 0.4 * carried_along, 0.0)
        dense += 0.6 * np.eye(len(chain))
        shared = structure.columns * [level[k], seat[k]]
        dense += same_run * (shared @ shared.T)
        dense += course[k] ** 2 * structure.course @ structure.course.T
        scale = laws.scale[k, structure.group]
        whole = np.linalg.solve(dense * np.outer(scale, scale), values)
        assert_allclose(gram[k], values.T @ whole, rtol=1e-8, atol=1e-8)
