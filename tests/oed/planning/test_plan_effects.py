"""Plans that allow for effects, and profiled unknowns of their stages, against dense updates."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from shipped_models import planar_2dof, pose_tracker

from kernel.plan_catalogues import linear_option, searched, stage_after
from oed import Measurement, mount
from oed.accuracy import ErrorMaps
from oed.design import Nuisances
from oed.design.forms.protocol import pairwise_traces
from oed.linear_algebra import symmetric_root
from oed.measurement import Series
from oed.planning import (
    Goal,
    Option,
    PlanProblem,
    PlanStreams,
    build_option,
    search_plan,
    workspace_goal,
)
from oed.planning.prediction import predict_stage, profile
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


def test_profiled_unknowns_leave_the_rows_of_the_joint_inverse(rng):
    """S' [1, -K] are the first rows of the joint inverse, and M - K K^T the noise."""
    n, s = 4, 2
    rows = rng.standard_normal((2, 9, 7))
    information = np.swapaxes(rows, 1, 2) @ rows
    prior = np.diag(rng.uniform(1.0, 5.0, n))
    profiled = profile(information, n, n + s)
    for k in range(2):
        joint = information[k] + np.eye(7)
        joint[:n, :n] += prior - np.eye(n)
        gain = np.linalg.inv(joint)[:n]
        covariance = np.linalg.inv(prior + profiled.machine[k])
        assert covariance == pytest.approx(gain[:, :n], rel=1e-9, abs=1e-12)
        by_setup = -covariance @ profiled.by_setup[k]
        assert by_setup == pytest.approx(gain[:, n : n + s], rel=1e-9, abs=1e-12)
        # other unknowns N(0, 1) and the noise, N(0, M), of the normal equations
        others = gain[:, n + s :]
        scatter = gain @ information[k] @ gain.T + others @ others.T
        noise = covariance @ profiled.noise[k] @ covariance
        assert noise == pytest.approx(scatter, rel=1e-9, abs=1e-12)


def test_roots_do_not_turn_where_eigenvalues_are_equal(rng):
    covariance = np.diag([2.0, 2.0, 2.0, 0.5])
    change = 1e-14 * rng.standard_normal((4, 4))
    near = covariance + change + change.T
    one, other = symmetric_root(np.array([covariance, near]))
    assert one @ one == pytest.approx(covariance, abs=1e-14)
    assert np.abs(one - other).max() < 1e-12


def losing_options(rng: np.random.Generator) -> list[Option]:
    """A rough option, and two precise ones that lose readings of machines far off."""
    # all directions are known equally well after the rough readings
    rough = 3.0 * np.vstack([np.eye(4), np.eye(4)])
    rough, times = (
        np.column_stack([rough, np.zeros(8)]),
        {"mounting": 300.0, "seconds": 60.0},
    )
    options = [linear_option("rough", rough, 4, counts=(4, 8), **times)]
    for name in ("a", "b"):
        rows = 30.0 * rng.standard_normal((12, 4))
        rows = np.column_stack([rows, np.full(12, 3.0)])
        options.append(
            linear_option(name, rows, 4, counts=(3, 6), travel=10.0, **times)
        )
    return options


def test_rounding_does_not_decide_which_plan_is_found(rng):
    """Rows that differ in their last digit lead to the same plan."""
    options = losing_options(rng)
    factors = rng.standard_normal((2, 2, 4))
    goal = Goal(("a", "b"), factors, np.ones(2), has_targets=False)
    first = searched(options, goal, 1800.0, stages=3, beam=3)
    assert any((s.probability < 0.9).any() for s in first.best.stages)
    changed = [_in_the_last_digit(option, rng) for option in options]
    other = searched(changed, goal, 1800.0, stages=3, beam=3)
    assert other.best.names == first.best.names
    assert other.best.value == pytest.approx(first.best.value, rel=1e-6)


def _in_the_last_digit(option: Option, rng: np.random.Generator) -> Option:
    blocks = option.candidates.blocks
    factor = 1.0 + 2e-16 * rng.integers(-1, 2, blocks.shape)
    candidates = dataclasses.replace(option.candidates, blocks=blocks * factor)
    return dataclasses.replace(option, candidates=candidates)


def test_a_stage_never_takes_information_away(rng):
    """Not even where machines that lose readings are farther off than believed."""
    _, option, _ = losing_options(rng)
    everything = np.arange(len(option.candidates))
    for _ in range(10):
        stage = stage_after(option, everything, np.eye(4), rng, exact=False)
        assert stage.lost_share > 0.5
        least = np.linalg.eigvalsh(stage.information)[0]
        assert least >= -1e-9 * np.trace(stage.information)


def test_rows_of_zeros_add_nothing_to_traces(rng):
    """tr(A_i P A_j Q) by the definition, for blocks of one to three rows."""
    blocks = rng.standard_normal((6, 3, 4))
    blocks[:3, 1:] = 0.0
    blocks[3, 2] = 0.0
    roots = rng.standard_normal((2, 4, 4))
    first, second = roots @ np.swapaxes(roots, 1, 2)
    a = np.swapaxes(blocks, 1, 2) @ blocks
    expected = [[np.trace(x @ first @ y @ second) for y in a] for x in a]
    traces = pairwise_traces(blocks, first, second)
    assert traces == pytest.approx(np.array(expected), rel=1e-10)
