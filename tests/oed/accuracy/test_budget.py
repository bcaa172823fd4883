"""The uncertainty budget: sums, each source by its own random numbers, and machines of
the oracle without a source.
"""

import dataclasses

import numpy as np
import pytest
from oracles import planar_geometry as planar
from shipped_models import planar_2dof, relative

from kernel import a3_plans, budget_machines
from oed import identifiability
from oed.accuracy import BudgetModel, ErrorMaps, variance_over_machines
from oed.accuracy.budget import mean_products, mean_variance
from oed.accuracy.maps import maps_by_reference
from oed.compensate import compensated_joints
from oed.estimation import identify
from oed.instrument import mount
from oed.measurement import Measurement, Series, draw_parameters, reading_structure
from oed.noise import Laws


@pytest.fixture(scope="module")
def plan() -> tuple[Measurement, Series]:
    return budget_machines.measured(budget_machines.Sources())


@pytest.fixture(scope="module")
def model(plan: tuple[Measurement, Series]) -> BudgetModel:
    m, series = plan
    return BudgetModel.of(m, [series], m.nominal)


@pytest.fixture(scope="module")
def maps(plan: tuple[Measurement, Series]) -> ErrorMaps:
    return ErrorMaps.of(plan[0].kinematics, a3_plans.workspace()[::5])


def all_errors(plan: tuple[Measurement, Series]) -> Laws:
    """A law with every error that the noise model knows."""
    structure = reading_structure(plan[0], [plan[1]], plan[0].nominal)
    groups = len(structure.names)
    one = np.ones(1)
    scale = 1.4 * np.ones((1, groups))
    return Laws(scale, 0.3 * one, 4.0 * one, 0.7 * one, 0.5 * one, course=0.6 * one)


def test_the_parts_add_up_to_the_posterior_covariance(
    plan: tuple[Measurement, Series], model: BudgetModel
) -> None:
    m, series = plan
    h = identifiability.scaled(m, [series], m.nominal, "tolerance")
    wanted = identifiability.posterior_covariance(h) * np.outer(
        m.tolerance, m.tolerance
    )
    scale = np.abs(wanted[:24, :24]).max()
    assert model.covariance() == pytest.approx(wanted[:24, :24], abs=1e-6 * scale)
    parts = model.parts()
    assert [p.source for p in parts] == [
        "unknown set-up",
        "error shared by a run",
        "noise of ball_bar",
        "combinations that no reading determines",
        "pull of the tolerances",
    ]
    total = np.sum([p.covariance for p in parts], axis=0)
    assert total == pytest.approx(model.covariance(), abs=1e-6 * scale)
    for part in parts:
        values = np.linalg.eigvalsh(part.covariance)
        # the information squares condition numbers, and each part is a difference
        assert values[0] > -1e-7 * scale, part.source


def test_every_error_of_an_estimated_law_has_its_line(
    plan: tuple[Measurement, Series], maps: ErrorMaps
) -> None:
    m, series = plan
    laws = all_errors(plan)
    model = BudgetModel.of(m, [series], m.nominal, laws=laws)
    estimated = 1.1 * model.covariance()
    predicted = 1.2 * mean_variance(mean_products(maps.raw), model.covariance())
    budget = model.budget(maps, estimated=estimated, predicted=predicted)
    assert [line.source for line in budget.lines] == [
        "unknown set-up",
        "run-to-run level",
        "error shared by a run",
        "set-up seated anew",
        "correlated noise of a run",
        "drift through the session",
        "noise beyond the stated one",
        "noise of ball_bar",
        "combinations that no reading determines",
        "pull of the tolerances",
        "estimated noise",
        "linearisation",
    ]
    total = np.sum([line.variance for line in budget.lines], axis=0)
    assert total == pytest.approx(budget.variance, rel=1e-6)
    assert budget.variance == pytest.approx(predicted)
    for of_sources in budget.shares().values():
        assert sum(of_sources.values()) == pytest.approx(1.0, abs=1e-6)


def realised(
    model: BudgetModel, maps: ErrorMaps, errors: np.ndarray, known: bool
) -> np.ndarray:
    """Rms (k,) of ridge estimates of drawn parameters from drawn errors (d, N)."""
    rng = np.random.default_rng(7)
    covariance = np.cov(errors.T)
    truth = rng.standard_normal((len(errors), len(model.names)))
    free = ~model.setup if known else np.ones(len(model.names), dtype=bool)
    h = model.slopes[:, free]
    y = truth[:, free] @ h.T + errors
    weighed = np.linalg.solve(covariance, h)
    inner = h.T @ weighed + np.eye(h.shape[1])
    estimate = np.zeros_like(truth)
    estimate[:, free] = np.linalg.solve(inner, weighed.T @ y.T).T
    estimate[:, ~free] = truth[:, ~free]
    delta = ((truth - estimate) @ model.root.T)[:, model.used]
    poses = np.einsum("nkp,dp->dnk", maps.raw, delta)
    return np.asarray(np.sqrt(np.mean(poses**2, axis=(0, 1))))


@pytest.mark.parametrize("source", ["all", "run", "noise", "set-up"])
def test_without_a_source_ridge_estimates_are_as_good_as_stated(
    source: str, model: BudgetModel, maps: ErrorMaps
) -> None:
    rng, count = np.random.default_rng(3), 6000
    single = rng.standard_normal((count, len(model.slopes)))
    level = rng.standard_normal((count, 5)).repeat(budget_machines.POINTS, axis=1)
    lines = {line.source: line for line in model.budget(maps).lines}
    size = {"noise": 0.5, "run": 1.0}.get(source, 1.0)
    shared = 0.0 if source == "run" else budget_machines.SHARED
    errors = size * single + shared * level
    wanted = {
        "all": np.sqrt(model.budget(maps).variance),
        "run": lines["error shared by a run"].without,
        "noise": lines["noise of ball_bar"].halved,
        "set-up": lines["unknown set-up"].without,
    }[source]
    got = realised(model, maps, errors, known=source == "set-up")
    assert got == pytest.approx(wanted, rel=0.05)


def test_variance_over_machines_is_that_about_each_of_them(
    plan: tuple[Measurement, Series], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One drawn machine: slopes about it, of a machine that has it as its nominal."""
    m, series = plan
    monkeypatch.setattr("oed.accuracy.budget.N_MACHINES", 1)
    command = a3_plans.workspace()[::20]
    got = variance_over_machines(
        m, [series], command, ("home", "best_fit"), np.random.default_rng(4)
    )
    truth = draw_parameters(m, np.random.default_rng(4), 1)[0]
    shifted = [
        dataclasses.replace(p, nominal=float(value))
        for p, value in zip(m.machine.parameters, truth, strict=False)
    ]
    other = Measurement(m.machine.with_parameters(shifted), list(m.setups.values()))
    covariance = BudgetModel.of(m, [series], truth).covariance()
    for reference, variance in got.items():
        maps = ErrorMaps.of(other.kinematics, command, reference)
        wanted = np.einsum("nkp,pq,nkq->nk", maps.raw, covariance, maps.raw)
        assert variance == pytest.approx(wanted, rel=1e-6)


def test_home_moves_with_the_tool(plan: tuple[Measurement, Series]) -> None:
    kinematics = plan[0].kinematics
    machine, tool = kinematics.machine, np.array([0.0, 0.0, 0.1])
    near_home = machine.home_command[None] + [0.0, 0.4, 1e-3]
    moved = machine.with_tool(near_home, tool)
    assert moved[0, 0] == near_home[0, 0] + 0.1
    maps = maps_by_reference(kinematics, moved, ("home", "absolute"), tool)
    zeroed, absolute = (np.abs(maps[r].raw[:, :3]).max() for r in maps)
    assert zeroed < 3e-3 * absolute


@pytest.mark.slow
def test_without_a_source_machines_of_the_oracle_are_as_good_as_stated() -> None:
    """Realised over predicted change of the rms height error, to 15 %."""
    command, machines = a3_plans.workspace()[::3], 60
    m, series = budget_machines.measured(budget_machines.Sources())
    model = BudgetModel.of(m, [series], m.nominal)
    maps = ErrorMaps.of(m.kinematics, command)
    z = maps.names.index("z")
    budget = model.budget(maps)
    lines = {line.source: line for line in budget.lines}

    def rms(sources: budget_machines.Sources) -> float:
        errors = budget_machines.height_errors(sources, command, machines, 11)
        return float(np.sqrt(np.mean(errors**2)))

    whole = rms(budget_machines.Sources())
    for name, (source, changed) in budget_machines.ALTERNATIVES.items():
        line = lines[source]
        stated = line.halved if name == "halved" else line.without
        predicted = stated[z] / np.sqrt(budget.variance[z])
        assert rms(changed) / whole == pytest.approx(predicted, rel=0.15), name


def relative_errors(shared: float, command: np.ndarray, count: int) -> np.ndarray:
    """Errors (count, n, 2) of compensated planar machines of the oracle, against home.

    Each line's readings refer to its first one, whose error they share; `shared` is the
    size of that error over the noise of the others.
    """
    m, series = planar_plan(shared)
    rng = np.random.default_rng(5)
    home = m.machine.home_command[None]
    errors = []
    for _ in range(count):
        truth = m.nominal[:7] + m.tolerance[:7] * rng.standard_normal(7)
        tilts = m.tolerance[7:] * rng.standard_normal(len(m.nominal) - 7)
        y = m.readings(series, np.concatenate([planar.NOMINAL, tilts]))
        y = y + planar_changes(truth) + planar_noise(m, series, shared, rng)
        believed = identify(m, series, y).theta[:7]
        both = np.vstack([command, home])
        q = compensated_joints(m.kinematics, both, believed)
        off = planar.forward(q, truth) - both
        errors.append(off[:-1] - off[-1])
    return np.array(errors)


def planar_plan(shared: float) -> tuple[Measurement, list[Series]]:
    """Relative measurements 4 and 5 with errors of their lines of another size."""
    instruments = [
        dataclasses.replace(
            getattr(relative, f"rm{k}"),
            channels=tuple(
                dataclasses.replace(c, shared=shared)
                for c in getattr(relative, f"rm{k}").channels
            ),
        )
        for k in (4, 5)
    ]
    m = Measurement(
        planar_2dof.machine,
        [mount(i, f"rm{k}") for i, k in zip(instruments, (4, 5), strict=True)],
    )
    series = []
    for k in (4, 5):
        pose, line = planar.lines(k)
        series.append(m.series(f"rm{k}", pose, run=[str(v) for v in line]))
    return m, series


def planar_changes(truth: np.ndarray) -> np.ndarray:
    """Changes of the relative readings by the oracle's machine."""
    parts = []
    for k, channels in ((4, [0]), (5, [0, 1])):
        pose, line = planar.lines(k)
        moved = planar.forward(planar.inverse(pose), truth) - pose
        parts.append(planar.relative(moved, line)[:, channels].ravel())
    return np.concatenate(parts)


def planar_noise(
    m: Measurement, series: list[Series], shared: float, rng: np.random.Generator
) -> np.ndarray:
    parts = []
    for s in series:
        sigma = np.array(m.setups[s.setup].sigma)
        single = rng.standard_normal((len(s), len(sigma)))
        lines = list(dict.fromkeys(s.run))
        level = rng.standard_normal((len(lines), len(sigma)))
        of_line = level[[lines.index(r) for r in s.run]]
        parts.append(((single + shared * of_line) * sigma).ravel())
    return np.concatenate(parts)


@pytest.mark.slow
def test_without_errors_of_runs_planar_machines_are_as_good_as_stated() -> None:
    """The reference reading of each line without its error: realised over predicted."""
    grid = [(y, z) for y in (-1.2, -0.4, 0.4, 1.2) for z in (0.1, 0.7, 1.3)]
    command, shared = np.array(grid), 3.0
    m, series = planar_plan(shared)
    maps = ErrorMaps.of(m.kinematics, command)
    budget = BudgetModel.of(m, series, m.nominal).budget(maps)
    line = next(li for li in budget.lines if li.source == "error shared by a run")
    assert line.without is not None
    predicted = line.without / np.sqrt(budget.variance)
    assert predicted.min() < 0.7
    whole, without = (
        np.sqrt(np.mean(relative_errors(s, command, 150) ** 2, axis=(0, 1)))
        for s in (shared, 0.0)
    )
    assert without / whole == pytest.approx(predicted, rel=0.15)
