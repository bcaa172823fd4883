"""A planar machine with gravity and over-constraint: diagnosed, corrected, predicted."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest
from effects_sample import NAMES, effect_of
from scipy import linalg
from shipped_models import planar_2dof, relative

from kernel.dense_noise import law_covariance
from oed.effect_model import Effect
from oed.gap.data import state as states_of
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import (
    GapProblem,
    assemble,
    exact_readings,
    prepare,
    signature,
)
from oed.gap.procedure import diagnose
from oed.instrument import mount
from oed.measurement import Measurement, Series

ACTING = (
    (
        "gravity",
        {"ratio": 0.47},
        {"drives": 2.0, "struts": 2.0},
    ),  # a weight beside the library's
    (
        "frame_bending",
        {"sag": 0.2},
        {"y by yz": -0.9, "y by zz": 1.5, "z by yy": -1.05, "z by yz": -1.2},
    ),
)


#: y (rm4) or z (rm5) of the lines, loads (N): those fitted, and others kept out
FITTED = {
    "rm4": ((-1.5, 0.0, 1.5), (0.0, 1500.0)),
    "rm5": ((0.0, 0.75, 1.5), (0.0, 1500.0)),
}


UNSEEN = {"rm4": ((-0.75, 0.75), (800.0,)), "rm5": ((0.375, 1.125), (800.0,))}


READS = {"rm4": 1, "rm5": 2}  # channels


def lines(
    m: Measurement, *parts: tuple[str, dict[str, Any]]
) -> tuple[list[Series], pd.DataFrame]:
    """Lines along z (rm4) and y (rm5) with their conditions; parts: (begin of the runs'
    names, places and loads).
    """
    series, rows = [], []
    for setup in READS:
        commands, runs = [], []
        for begin, where in parts:
            for load in where[setup][1]:
                for at in where[setup][0]:
                    s = (
                        np.linspace(0.0, 1.5, 11)
                        if setup == "rm4"
                        else np.linspace(-1.5, 1.5, 13)
                    )
                    commands.append(
                        np.column_stack(
                            [0 * s + at, s] if setup == "rm4" else [s, 0 * s + at]
                        )
                    )
                    run = {
                        "setup": setup,
                        "run": f"{begin} {at} m {load} N",
                        "payload": load,
                    }
                    runs += [
                        run | {"order": k + 1, "direction": 1.0, "feed": 1.0 / 60.0}
                        for k in range(len(s))
                    ]
        series.append(
            m.series(setup, np.vstack(commands), run=[r["run"] for r in runs])
        )
        rows += [
            r for r in runs if r["order"] > 1
        ]  # the first of a line is its reference
    return series, pd.DataFrame(rows).assign(
        time=lambda t: 1800.0 + 20.0 * np.arange(len(t))
    )


@dataclasses.dataclass
class Planar:
    """A virtual planar machine: the diagnosis of its lines, and all readings with those
    kept out.
    """

    diagnosis: Diagnosis
    whole: GapProblem
    held: np.ndarray


def planar(seed: int) -> Planar:
    m = Measurement(
        planar_2dof.machine, [mount(getattr(relative, n), n) for n in READS]
    )
    rng = np.random.default_rng(seed)
    theta = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    series, rows = lines(m, ("fitted", FITTED), ("unseen", UNSEEN))
    states = states_of.states(m, tuple(series), rows, theta)
    noise = m.noise(series)
    y = exact_readings(
        m, series, theta, states, [(effect_of(n), c, f) for n, c, f in ACTING]
    )
    y = y + noise.draw(rng, y.shape)
    count = rows["setup"].map(READS).to_numpy()
    held = np.repeat(rows["run"].str.startswith("unseen").to_numpy(), count)
    fitted, known = lines(m, ("fitted", FITTED))
    problem = prepare(m, fitted, y[~held], known)
    diagnosis = diagnose(
        problem, [effect_of(n) for n in NAMES], np.random.default_rng(1)
    )
    return Planar(diagnosis, assemble(m, series, rows, problem.theta, y), held)


def predicted(case: Planar) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Errors (k,) of the unseen readings without and with the effects named,
    covariances (k, k) of both; um.

    Dense Gaussian conditioning on the fitted readings; constants (the platform's
    weight) are the library's likeliest.
    """
    whole, held = case.whole, case.held
    noise = np.zeros((len(whole), len(whole)))
    for members in whole.members:
        stated = law_covariance(whole.stated_law, whole, members)
        noise[np.ix_(members, members)] = stated
    plain = noise + whole.slopes @ whole.slopes.T
    named = [
        effect_of(n)
        for n in dict.fromkeys(c.effect for c in case.diagnosis.coefficients)
    ]
    choices = itertools.product(
        *([(e, point) for point in e.constant_grid()] for e in named)
    )
    best = max(
        (corrected(case, plain, forms) for forms in choices),
        key=lambda c: evidence(case, c),
    )
    um = 1e6 * whole.sigma[held]
    e0, p0 = conditioned(plain, whole.residual, held)
    e1, p1 = conditioned(best, whole.residual, held)
    return um * e0, um * e1, np.outer(um, um) * p0, np.outer(um, um) * p1


def corrected(
    case: Planar, plain: np.ndarray, forms: Sequence[tuple[Effect, dict[str, float]]]
) -> np.ndarray:
    """Covariance (N, N) with the coefficients that the diagnosis names, wide
    beforehand.
    """
    w, named = case.whole, {(c.effect, c.name) for c in case.diagnosis.coefficients}
    for effect, point in forms:
        effect_signature = signature(
            effect, point, w.states, w.responses, w.measurement, w.series, w.sigma
        )
        columns = (
            3.0
            * w.in_noise_units(effect_signature.columns)[
                :, [(effect.name, n) in named for n in effect_signature.names]
            ]
        )
        plain = plain + columns @ columns.T
    return plain


def evidence(case: Planar, covariance: np.ndarray) -> float:
    root = linalg.cholesky(covariance[np.ix_(~case.held, ~case.held)], lower=True)
    white = linalg.solve_triangular(root, case.whole.residual[~case.held], lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(root)).sum())


def conditioned(
    covariance: np.ndarray, residual: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    cross = covariance[np.ix_(held, ~held)]
    gain = np.linalg.solve(covariance[np.ix_(~held, ~held)], cross.T).T
    return (
        residual[held] - gain @ residual[~held],
        covariance[np.ix_(held, held)] - gain @ cross.T,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("machines", "least"), [(1, 1), (6, 9)])
def test_the_planar_gap_is_gravity_and_bending_and_shrinks_on_unseen_lines(
    machines: int, least: int
) -> None:
    """What geometry leaves, up to 0.06 mm, goes down to about 0.01 mm on lines and a
    load that were not fitted.

    The rms of what is left there lies in its 95 % interval, channel by channel, in at
    least 9 of 12 cases: 8 or fewer are a matter of 0.3 %, as none of 2 is of
    0.25 %. The shrink itself reaches the lower end of what the diagnosis said of unseen
    runs. In one machine an effect more may be named (the weight is between two of the library's).
    """
    inside, alone, draws = [], [], np.random.default_rng(7)
    for seed in range(machines):
        case = planar(seed)
        assert min(case.diagnosis.marginal[n] for n, _, _ in ACTING) > 0.95
        alone.append(
            set(case.diagnosis.answers[0].effects) == {n for n, _, _ in ACTING}
        )
        told = [b.block for b in case.diagnosis.where if b.p_value < 0.05]
        assert not any(block.startswith("leg") for block in told)
        before, after, without, with_them = predicted(case)
        assert 40.0 < np.abs(before).max() < 90.0
        assert np.abs(after).max() < 20.0
        assert np.sqrt(np.mean(after**2)) < 6.0
        white0, white1 = (
            np.linalg.solve(np.linalg.cholesky(without), e) for e in (before, after)
        )
        s0, s1 = np.mean(white0**2), np.mean(white1**2)
        closure = next(c for c in case.diagnosis.closure if c.split == "whole")
        assert closure.low > 0.9
        assert (s0 - s1) / (s0 - 1.0) > closure.low - 3.0 * np.sqrt(
            2.0 / len(after)
        ) / (s0 - 1.0)
        root = np.linalg.cholesky(with_them)
        likely = root @ draws.standard_normal((len(root), 2000))
        channel = case.whole.rows["channel"].to_numpy()[case.held]
        for name in ("dy", "dz"):
            low, high = np.percentile(
                np.sqrt(np.mean(likely[channel == name] ** 2, axis=0)), [2.5, 97.5]
            )
            inside.append(low <= np.sqrt(np.mean(after[channel == name] ** 2)) <= high)
    assert sum(alone) >= machines - 1
    assert sum(inside) >= least
