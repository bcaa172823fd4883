"""The blind benchmark's baselines: stepwise regression and harmonic rules."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The benchmark's modules."""
    return blind_modules("harmonic", "loading", "stepwise")


@pytest.fixture(scope="module")
def problem(blind, blind_case_set):
    """A null case of the A3's full plan."""
    wanted = next(
        c for c in blind.loading.manifest(blind_case_set) if c.plan == "a3_full"
    )
    return blind.loading.prepare(blind_case_set, wanted)


def clean(problem, seed: int):
    """White noise in place of the residuals, and parameters within their tolerances."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=problem.slopes.shape[1])
    return problem.with_residual(rng.normal(size=len(problem)) + problem.slopes @ theta)


def test_stepwise_takes_the_form_of_least_bic(blind, problem):
    """Against explicit least squares with a row a parameter for its tolerance."""
    from oed.gap.forms import library as library_of

    effects = [
        e
        for e in blind.loading.bench("a3_full.study.toml").effects
        if e.name in ("servo_lag", "gravity", "bar_length")
    ]
    library = library_of.build(problem, effects)
    lag = next(
        a for a in library.atoms if a.effect == "servo_lag" and len(a.columns) > 1
    )
    quiet = clean(problem, 1)
    acting = quiet.with_residual(
        quiet.residual
        + library.columns[:, lag.columns] @ np.full(len(lag.columns), 0.5)
    )
    assert blind.stepwise.stepwise(quiet, library) == []

    def bic(columns) -> float:
        n, m = problem.slopes.shape
        design = np.block(
            [
                [problem.slopes, library.columns[:, columns]],
                [np.eye(m), np.zeros((m, len(columns)))],
            ]
        )
        target = np.concatenate([acting.residual, np.zeros(m)])
        scale = np.linalg.norm(design, axis=0)
        residual = (
            target
            - (design / scale) @ np.linalg.lstsq(design / scale, target, rcond=1e-12)[0]
        )
        return n * math.log(residual @ residual) + len(columns) * math.log(n)

    bics = {
        k: bic(a.columns) + len(a.constants) * math.log(len(problem))
        for k, a in enumerate(library.atoms)
    }
    best = min(bics, key=lambda k: bics[k])
    assert bics[best] < bic([])
    assert (
        blind.stepwise.stepwise(acting, library)[0]
        == library.atoms[best].effect
        == "servo_lag"
    )


def test_harmonic_rules_are_silent_at_white_noise(blind, problem):
    names = [e.name for e in blind.loading.bench("a3_full.study.toml").effects]
    alarms = sum(
        bool(blind.harmonic.harmonic(clean(problem, seed), names)) for seed in range(20)
    )
    assert alarms <= 2  # set for 1 %: three and more have a chance of 0.1 %


@pytest.mark.parametrize("symptom", ["lag", "payload", "jump"])
def test_harmonic_rules_name_what_stands_out(blind, problem, symptom):
    rows, quiet = problem.rows, clean(problem, 4)
    phase, last = rows["phase"].to_numpy(), rows["time"].max()
    change = {
        "lag": (
            rows["direction"] * rows["feed"] / rows["feed"].max() * np.cos(2 * phase)
        ),
        "payload": rows["payload"] / rows["payload"].max() * np.cos(3 * phase),
        "jump": (rows["time"] > 0.3 * last) * 1.0,
    }[symptom]
    named = blind.harmonic.harmonic(
        quiet.with_residual(quiet.residual + 5.0 * np.asarray(change, dtype=float)),
        [e.name for e in blind.loading.bench("a3_full.study.toml").effects],
    )
    assert (
        named[0] == {"lag": "servo_lag", "payload": "gravity", "jump": "step"}[symptom]
    )
