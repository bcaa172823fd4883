"""Where a gap lies: energies by dense closed forms, places by virtual machines."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from kernel import gap_problem as case
from kernel.cases import CASES, reading_series
from kernel.laws import STATED_LAW
from oed.gap.cause.locations import STANDING_OUT, LikelyForms, draw_energies, locate
from oed.gap.data.problem import GapProblem, assemble
from oed.result import PlaceRecord

KINDS = ("leg", "run", "time", "phase", "direction")
LEGS = ("leg 1", "leg 2", "leg 3")


@dataclasses.dataclass(frozen=True)
class Machines:
    """Readings of virtual machines, drawn with dense matrices."""

    problem: GapProblem
    covariance: np.ndarray
    root: np.ndarray

    def located(self, change, model, seed):
        """Places, by name, of a change (N,) of the readings; most likely first."""
        rng = np.random.default_rng(seed)
        noise = self.root @ rng.standard_normal(len(self.problem))
        read = self.problem.with_residual(noise + change)
        blocks = locate(read, case.law(read), [model], rng)
        return {b.block: b for b in blocks}

    def sized(self, change: np.ndarray, size: float) -> np.ndarray:
        return case.sized(change, self.covariance, size)


@pytest.fixture(scope="module")
def machines() -> Machines:
    problem = case.circles()
    covariance = case.dense(problem, case.law(problem))
    return Machines(problem, covariance, np.linalg.cholesky(covariance))


def _first(blocks: dict[str, PlaceRecord], kind: str) -> str:
    return next(name for name in blocks if name.startswith(kind))


def _in_legs(problem: GapProblem, size: float) -> LikelyForms:
    """Play of each leg, of this size."""
    sense = problem.states[0].motion_sign
    columns = [case.in_joint(problem, k, 1e-6 * sense[:, k]) for k in range(3)]
    forms = size * np.column_stack(columns)
    return LikelyForms(1.0, forms, LEGS, other_way=-forms)


def _span(block: str) -> tuple[float, float]:
    begin, _, end = block.removeprefix("time ").partition("-")
    return float(begin), float(end)


# -- the numbers -----------------------------------------------------------------------
def test_shares_are_those_of_the_posterior_in_closed_form(machines):
    """E e = tr A E(beta beta^T), by dense matrices, reading by reading and leg by leg."""
    problem, rng = machines.problem, np.random.default_rng(2)
    model = _in_legs(problem, 2.0)
    G, M = model.columns, np.linalg.inv(machines.covariance)
    read = problem.with_residual(
        machines.root @ rng.standard_normal(len(problem)) + G @ [1.0, 0.3, -0.2]
    )
    drawn = draw_energies(read, case.law(read), [model], rng, 40_000)
    V = np.linalg.inv(G.T @ M @ G + np.eye(3))
    m = V @ G.T @ M @ read.residual
    second = V + np.outer(m, m)
    left = _left(machines, G)
    for k, leg in enumerate(LEGS):
        expected = left[:, k] @ left[:, k] * second[k, k]
        assert_allclose(drawn.parts[leg].mean(), expected, rtol=0.02)
    for energy, columns in ((drawn.acting, G), (drawn.remaining, left)):
        by_reading = np.einsum("nk,kl,nl->n", columns, second, columns)
        assert_allclose(energy.mean(), by_reading, rtol=0.05)
        assert_allclose(
            energy.sums(slice(2, 9)).mean(), by_reading[2:9].sum(), rtol=0.05
        )


def _left(machines: Machines, columns: np.ndarray) -> np.ndarray:
    """What generalised least squares with the parameters' prior leaves of columns."""
    H = machines.problem.slopes
    precision = np.linalg.inv(machines.covariance - H @ H.T)
    inner = H.T @ precision @ H + np.eye(H.shape[1])
    return columns - H @ np.linalg.solve(inner, H.T @ precision @ columns)


def test_p_value_is_the_chance_that_a_place_holds_no_more_than_its_share(machines):
    """Effects drawn from their prior: of places of p-value p, the share p has none."""
    problem = machines.problem
    model = _in_legs(problem, 0.2)
    energy = np.sum(_left(machines, model.columns) ** 2, axis=0)
    p_values, none = [], []
    for seed in range(150):
        beta = np.random.default_rng([seed, 1]).standard_normal(3)
        blocks = machines.located(model.columns @ beta, model, seed)
        parts = energy * beta**2
        p_values += [blocks[leg].p_value for leg in LEGS]
        none += list(parts / parts.sum() <= 1.0 / 3.0)
    p, true = np.array(p_values), np.array(none)
    for low, high in ((0.0, 0.1), (0.1, 0.6), (0.6, 0.9), (0.9, 1.01)):
        inside = (p >= low) & (p < high)
        expected, n = p[inside].mean(), inside.sum()
        assert n > 25
        spread = np.sqrt(max(expected * (1.0 - expected), 0.02) / n)
        assert abs(true[inside].mean() - expected) < 3.5 * spread


def test_of_several_forms_each_counts_by_its_share(machines):
    problem, rng = machines.problem, np.random.default_rng(3)
    every = _in_legs(problem, 3.0)
    alone = [
        LikelyForms(share, every.columns[:, [k]], LEGS[k : k + 1])
        for k, share in ((0, 0.75), (1, 0.25))
    ]
    blocks = locate(problem, case.law(problem), alone, rng, draws=4000)
    strength = {b.block: b.strength for b in blocks}
    assert_allclose([strength["leg 1"], strength["leg 2"]], [0.75, 0.25], atol=0.03)
    assert "leg 3" not in strength


# -- the places ------------------------------------------------------------------------
def test_an_effect_in_one_leg_is_found_there(machines):
    model = _in_legs(machines.problem, 2.0)
    for seed in range(12):
        leg = seed % 3
        change = machines.sized(model.columns[:, leg], 8.0)
        blocks = machines.located(change, model, seed)
        assert _first(blocks, "leg") == LEGS[leg]
        assert blocks[LEGS[leg]].p_value < 0.05


def test_without_a_gap_no_leg_stands_out_more_often_than_stated(machines):
    model, nothing = _in_legs(machines.problem, 2.0), np.zeros(len(machines.problem))
    claimed = 0
    for seed in range(60):
        blocks = machines.located(nothing, model, seed)
        claimed += min(blocks[leg].p_value for leg in LEGS) < 0.05
    assert claimed <= 9


def test_a_fault_in_one_run_is_found_there(machines):
    problem, right = machines.problem, 0
    phase = problem.rows["phase"].to_numpy()
    waves = np.zeros((len(problem), 2 * len(problem.members)))
    for k, members in enumerate(problem.members):
        waves[members, 2 * k] = np.cos(phase[members])
        waves[members, 2 * k + 1] = np.sin(phase[members])
    model = LikelyForms(1.0, waves, [""] * waves.shape[1])
    for seed in range(12):
        members = problem.members[seed % 6]
        change = np.zeros(len(problem))
        change[members] = np.cos(phase[members] + seed)
        blocks = machines.located(machines.sized(change, 8.0), model, seed)
        right += _first(blocks, "run") == f"run {problem.rows['run'][members[0]]}"
    assert right >= 11


def test_a_step_is_told_from_its_time_to_the_end(machines):
    problem = machines.problem
    time = problem.rows["time"].to_numpy(dtype=float)
    for seed, start in enumerate((153.0, 399.0, 651.0)):
        step = (time >= start).astype(float)[:, None]
        blocks = machines.located(
            machines.sized(step[:, 0], 12.0), LikelyForms(1.0, step, [""]), seed
        )
        begin, end = _span(_first(blocks, "time"))
        assert abs(begin - start) <= 18.0  # three readings: a cell
        assert end == time.max()
        assert blocks[_first(blocks, "time")].p_value < 0.05


def test_a_stretch_ends_halfway_to_the_readings_beside_it(machines):
    """When a fault came and went nobody saw, but it was between two readings."""
    rows = machines.problem.rows
    late = rows["time"] + 600.0 * rows["run"].ne(rows["run"].shift()).cumsum()
    problem = dataclasses.replace(machines.problem, rows=rows.assign(time=late))
    inside, time = problem.members[3], late.to_numpy(dtype=float)
    fault = np.zeros((len(problem), 1))
    fault[inside] = 1.0
    read = problem.with_residual(20.0 * fault[:, 0])
    rng = np.random.default_rng(1)
    blocks = locate(read, case.law(read), [LikelyForms(1.0, 20.0 * fault, [""])], rng)
    before, after = time[problem.members[2]].max(), time[problem.members[4]].min()
    begin, end = _span(next(b.block for b in blocks if b.block.startswith("time")))
    assert begin == pytest.approx(0.5 * (before + time[inside].min()), abs=0.06)
    assert end == pytest.approx(0.5 * (time[inside].max() + after), abs=0.06)


def test_a_bump_in_the_phase_is_found_there_over_the_start_too(machines):
    phase = np.rad2deg(machines.problem.rows["phase"].to_numpy())
    number = (phase // 30.0).astype(int)
    sectors = (number[:, None] == np.arange(12)).astype(float)
    bump = sectors[:, 11] + sectors[:, 0]
    model = LikelyForms(1.0, 5.0 * sectors, [""] * 12)
    blocks = machines.located(machines.sized(bump, 16.0), model, 4)
    begin, _, end = _first(blocks, "phase").removeprefix("phase ").partition("-")
    assert begin in ("300", "330")
    assert end in ("30", "60")


@pytest.mark.parametrize("waves", [2, 6])
def test_a_fault_in_one_direction_is_found_where_calibration_leaves_it(waves, machines):
    """Of two waves a turn calibration absorbs the mean of both ways, of six nothing."""
    rows = machines.problem.rows
    wave = np.cos(waves * rows["phase"].to_numpy() + 1.0)
    ways = rows["direction"].to_numpy()
    columns = np.column_stack([wave * (ways == 1), wave * (ways == -1)])
    forms = 5.0 * columns
    model = LikelyForms(1.0, forms, ["", ""], other_way=forms[:, ::-1])
    blocks = machines.located(machines.sized(columns[:, 1], 14.0), model, 5)
    shares = {2: 0.5, 6: 1.0}
    found = blocks["direction -1"]
    assert found.strength == pytest.approx(shares[waves], abs=0.1)
    assert (found.p_value < STANDING_OUT) == (waves == 6)


def test_same_seed_same_places_sorted_and_told_once(machines):
    model = _in_legs(machines.problem, 2.0)
    nothing = np.zeros(len(machines.problem))
    a, b = (list(machines.located(nothing, model, 3).values()) for _ in range(2))
    assert a == b
    clear = [x.p_value < STANDING_OUT for x in a]
    assert clear == sorted(clear, reverse=True)
    assert all(0.0 <= x.strength <= 1.0 and 0.0 < x.p_value <= 1.0 for x in a)
    kinds = {x.block.split(" ")[0] for x in a}
    assert {"leg", "run", "direction"} <= kinds <= set(KINDS)
    assert len({x.block for x in a}) == len(a)


@pytest.mark.parametrize(
    ("machine", "setup"), [("hexapod", "camera"), ("planar_2dof", "rm3")]
)
def test_readings_without_covariates_and_with_several_channels(machine, setup, rng):
    measurement, series = reading_series(CASES[machine], setup, rng, 40)
    labels = np.array([f"r{k // 10}" for k in range(len(series))])
    if measurement.setups[setup].instrument.reference != "run":
        series = dataclasses.replace(series, run=labels)
    order = pd.Series(series.run).groupby(series.run).cumcount() + 2
    table = pd.DataFrame({"setup": setup, "run": series.run, "order": order})
    problem = assemble(measurement, [series], table)
    hit = np.zeros((len(problem), len(problem.members)))
    for k, members in enumerate(problem.members):
        hit[members, k] = rng.standard_normal(len(members))
    noise = problem.residual + rng.standard_normal(len(problem))
    read = problem.with_residual(noise + 30.0 * hit[:, 1])
    model = LikelyForms(1.0, 30.0 * hit, [""] * hit.shape[1])
    blocks = locate(read, STATED_LAW, [model], rng)
    names = [b.block for b in blocks]
    assert not any(n.startswith(("time", "direction", "leg")) for n in names)
    first = next(n for n in names if n.startswith("run"))
    assert first == f"run {problem.rows['run'][problem.members[1][0]]}"
