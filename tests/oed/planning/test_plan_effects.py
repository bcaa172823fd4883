"""Plans that allow for effects: stages against a dense Bayesian update, and the words."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from shipped_models import planar_2dof, pose_tracker

from oed import Measurement, mount
from oed.accuracy import ErrorMaps
from oed.design import Nuisances
from oed.measurement import Series
from oed.planning import (
    Option,
    PlanProblem,
    PlanStreams,
    build_option,
    search_plan,
    workspace_goal,
)
from oed.planning.prediction import predict_stage
from pkm_studies.base import InputError
from pkm_studies.resolve import resolve
from pkm_studies.study import Study

machine = planar_2dof.machine

SIGMA, EFFECTS = 5e-6, 4
PLANAR = Path(__file__).parents[3] / "studies" / "planar_plan.study.toml"


def tracker(name: str, seed: int) -> tuple[Option, Measurement, Series]:
    """Positions of the tool, which drawn effects change, and their measurement."""
    setup = mount(pose_tracker.position, name, sigma=(SIGMA,) * 3)
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 4), np.linspace(0.2, 1.3, 3))
    measurement = Measurement(machine, [setup])
    command = np.column_stack([y.ravel(), z.ravel()])
    series = measurement.series(name, command)
    rng = np.random.default_rng(seed)
    columns = 20e-6 * rng.standard_normal((36, EFFECTS))
    nuisances = Nuisances(columns, 10e-6 * rng.random(36))
    times = {"mounting_seconds": 60.0, "reading_seconds": 10.0}
    few = {"name": name, "counts": (3, 6), "nuisances": nuisances}
    option = build_option(machine, [setup], [series], **few, **times)
    return option, measurement, series


def dense_update(prior, option, measurement, chosen):
    """Covariance of machine and effects after readings, set-up unknowns integrated out."""
    numbers = (3 * chosen[:, None] + np.arange(3)).ravel()
    slopes = measurement.jacobian(option.series, measurement.nominal)[numbers]
    slopes = (slopes * measurement.tolerance)[:, measurement.free]
    free = int(measurement.free[: len(machine.parameters)].sum())
    nuisances = option.candidates.nuisances
    h = np.hstack([slopes[:, :free], nuisances.columns[numbers]])
    of_setup = slopes[:, free:]
    scatter = nuisances.scatter[numbers]
    noise = np.diag(SIGMA**2 + scatter**2) + of_setup @ of_setup.T
    gain = prior @ h.T @ np.linalg.inv(noise + h @ prior @ h.T)
    return np.asarray(prior - gain @ h @ prior)


def test_stages_carry_what_is_known_of_the_effects():
    first, one, _ = tracker("first", 1)
    second, two, _ = tracker("second", 2)
    prior = np.eye(first.machine_columns)
    assert len(prior) == int(one.free[: len(machine.parameters)].sum()) + EFFECTS
    rng = np.random.default_rng(0)
    everything = np.ones(12)
    chosen = np.array([0, 3, 7, 11])
    after_first = predict_stage(first, chosen, prior, everything, rng, exact=False)
    expected = dense_update(prior, first, one, chosen)
    assert after_first.covariance == pytest.approx(expected, rel=1e-6, abs=1e-9)
    others = np.array([1, 5, 10])
    known = after_first.posterior
    after_both = predict_stage(second, others, known, everything, rng, exact=False)
    expected = dense_update(expected, second, two, others)
    assert after_both.covariance == pytest.approx(expected, rel=1e-5, abs=1e-9)
    with_residual = predict_stage(first, chosen, prior, everything, rng)
    ratio = np.diag(with_residual.covariance) / np.diag(after_first.covariance)
    assert (ratio > 1.0 - 1e-9).all()


def test_the_bound_holds_over_all_plans():
    """Every plan of one option, with all errors that no reading reduces."""
    option, measurement, _ = tracker("only", 3)
    command = np.array([[-1.0, 0.4], [0.0, 0.9], [1.0, 0.6]])
    maps = ErrorMaps.of(measurement.kinematics, command)
    rng = np.random.default_rng(4)
    tool = 15e-6 * rng.standard_normal((3, len(maps.names), EFFECTS))
    rest = np.full(len(maps.names), 1e-12)
    goal = workspace_goal(
        measurement, maps, {}, SimpleNamespace(tool=tool, others=rest)
    )
    budget = 60.0 + 6 * 10.0
    streams, start = PlanStreams.seeded([1]), np.eye(goal.parameters)
    problem = PlanProblem((option,), goal, budget, 1, start, streams)
    found = search_plan(problem)
    assert found.best.value >= found.bound.value * (1.0 - 1e-9)
    for _ in range(200):
        chosen = rng.choice(12, size=6, replace=False)
        covariance = dense_update(
            np.eye(goal.parameters), option, measurement, np.sort(chosen)
        )
        value = goal.value(covariance)
        assert value >= found.bound.value * (1.0 - 1e-9)
        assert value >= found.best.value * 0.98


def with_effects(folder: Path, effects: str, machines: int) -> Path:
    """The planar plan with effects and virtual machines."""
    text = PLANAR.read_text(encoding="utf-8")
    study = folder / "planar_plan.study.toml"
    lines = f"virtual_machines = {machines}\neffects = {effects}"
    changed = text.replace("virtual_machines = 200", lines)
    assert changed != text
    study.write_text(changed, encoding="utf-8")
    return study


@pytest.mark.parametrize(("effects", "machines", "words"), [
    ('"catalogue"', 200, "virtual machines"),
    ('["wind"]', 0, r"effects\[1\].*no such effect"),
])  # fmt: skip
def test_what_a_plan_cannot_allow_for_is_refused(tmp_path, effects, machines, words):
    study = Study.load(with_effects(tmp_path, effects, machines))
    with pytest.raises(InputError, match=words):
        resolve(study, readings=[])
