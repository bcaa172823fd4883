"""A planar machine with gravity and over-constraint: diagnosed, corrected, predicted."""

import itertools

import numpy as np
import pandas as pd
import pytest
from effects_sample import NAMES, effect_of
from scipy import stats
from shipped_models import planar_2dof, relative

from kernel.laws import residual_covariance
from oed.gap.data import state as states_of
from oed.gap.data.problem import assemble, exact_readings, prepare
from oed.gap.procedure import diagnose
from oed.instrument import mount
from oed.measurement import Measurement

BENT = {"y by yz": -0.9, "y by zz": 1.5, "z by yy": -1.05, "z by yz": -1.2}
#: a weight beside the library's, and an over-constrained frame
ACTING = (
    ("gravity", {"ratio": 0.47}, {"drives": 2.0, "struts": 2.0}),
    ("frame_bending", {"sag": 0.2}, BENT),
)
#: y of the lines along z (rm4), z of those along y (rm5), loads (N); the same, kept out
FITTED = {"rm4": ((-1.5, 0.0, 1.5), (0.0, 1500.0)), "rm5": ((0.0, 0.75, 1.5), (0.0, 1500.0))}  # fmt: skip
UNSEEN = {"rm4": ((-0.75, 0.75), (800.0,)), "rm5": ((0.375, 1.125), (800.0,))}
READS = {"rm4": 1, "rm5": 2}  # channels
AS = {"direction": 1.0, "feed": 1.0 / 60.0}


def lines(m, parts):
    """Series and conditions of lines; the first pose of a line is its reference."""
    series, rows = [], []
    for setup, (first, count) in {"rm4": (0.0, 11), "rm5": (-1.5, 13)}.items():
        along = np.linspace(first, 1.5, count)
        commands, runs = [], []
        for begin, where in parts.items():
            for load, at in itertools.product(*reversed(where[setup])):
                line = [np.full(len(along), at), along]
                commands += np.column_stack(
                    line if setup == "rm4" else line[::-1]
                ).tolist()
                run = {
                    "setup": setup,
                    "run": f"{begin} {at} m {load} N",
                    "payload": load,
                }
                runs += [run | AS | {"order": k + 1} for k in range(len(along))]
        series.append(m.series(setup, np.array(commands), run=[r["run"] for r in runs]))
        rows += [r for r in runs if r["order"] > 1]
    return series, pd.DataFrame(rows).assign(time=1800.0 + 20.0 * np.arange(len(rows)))


def planar(seed):
    """The diagnosis of the fitted lines, all readings, and which of them were kept out."""
    m = Measurement(
        planar_2dof.machine, [mount(getattr(relative, n), n) for n in READS]
    )
    rng = np.random.default_rng(seed)
    theta = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    series, rows = lines(m, {"fitted": FITTED, "unseen": UNSEEN})
    states = states_of.states(m, tuple(series), rows, theta)
    acting = [(effect_of(n), c, f) for n, c, f in ACTING]
    y = exact_readings(m, series, theta, states, acting)
    y = y + m.noise(series).draw(rng, y.shape)
    held = np.repeat(
        rows["run"].str.startswith("unseen"), rows["setup"].map(READS)
    ).to_numpy()
    fitted, known = lines(m, {"fitted": FITTED})
    problem = prepare(m, fitted, y[~held], known)
    effects = [effect_of(n) for n in NAMES]
    diagnosis = diagnose(problem, effects, np.random.default_rng(1))
    return diagnosis, assemble(m, series, rows, problem.theta, y), held


def predicted(diagnosis, whole, held):
    """Errors (um) of the unseen readings and their covariance, without and with effects.

    Dense conditioning on the fitted readings; constants are the library's likeliest.
    """
    plain = residual_covariance(whole, whole.stated_law)
    named = {(c.effect, c.name) for c in diagnosis.coefficients}
    effects = [effect_of(n) for n in sorted({effect for effect, _ in named})]
    every = []
    for points in itertools.product(*(e.constant_grid() for e in effects)):
        covariance = plain
        for effect, point in zip(effects, points, strict=True):
            signature = whole.signature(effect, point)
            chosen = [(effect.name, n) in named for n in signature.names]
            columns = 3.0 * whole.noise_units(signature.columns)[:, chosen]
            covariance = covariance + columns @ columns.T
        every.append(covariance)
    fitted, um = np.ix_(~held, ~held), 1e6 * whole.sigma[held]
    nothing, y = np.zeros((~held).sum()), whole.residual[~held]
    best = max(
        every, key=lambda c: stats.multivariate_normal(nothing, c[fitted]).logpdf(y)
    )
    for c in (plain, best):
        gain = np.linalg.solve(c[fitted], c[np.ix_(~held, held)]).T
        left = c[np.ix_(held, held)] - gain @ c[np.ix_(~held, held)]
        yield um * (whole.residual[held] - gain @ y), np.outer(um, um) * left


@pytest.mark.slow
def test_the_planar_gap_is_gravity_and_bending_and_shrinks_on_unseen_lines():
    """Of 0.06 mm some 0.01 mm remain there; 8 of 12 in their 95 % are a matter of 0.3 %.

    In one machine an effect more may be named: the weight is between two of the library's.
    """
    inside, alone, draws = [], [], np.random.default_rng(7)
    for seed in range(6):
        diagnosis, whole, held = planar(seed)
        assert min(diagnosis.marginal[n] for n, _, _ in ACTING) > 0.95
        alone.append(set(diagnosis.answers[0].effects) == {n for n, _, _ in ACTING})
        told = [b.block for b in diagnosis.where if b.p_value < 0.05]
        assert not any(block.startswith("leg") for block in told)
        (before, without), (after, with_them) = predicted(diagnosis, whole, held)
        assert 40.0 < np.abs(before).max() < 90.0
        assert np.abs(after).max() < 20.0
        assert np.sqrt(np.mean(after**2)) < 6.0
        white = np.linalg.inv(np.linalg.cholesky(without))
        s0, s1 = (np.mean((white @ e) ** 2) for e in (before, after))
        closure = next(c for c in diagnosis.closure if c.split == "whole")
        assert closure.low > 0.9
        margin = 3.0 * np.sqrt(2.0 / len(after)) / (s0 - 1.0)
        assert (s0 - s1) / (s0 - 1.0) > closure.low - margin
        likely = np.linalg.cholesky(with_them) @ draws.standard_normal(
            (held.sum(), 2000)
        )
        channel = whole.rows["channel"].to_numpy()[held]
        for of in (channel == "dy", channel == "dz"):
            sizes = np.sqrt(np.mean(likely[of] ** 2, axis=0))
            low, high = np.percentile(sizes, [2.5, 97.5])
            inside.append(low <= np.sqrt(np.mean(after[of] ** 2)) <= high)
    assert sum(alone) >= 5
    assert sum(inside) >= 9
