"""Where a gap lies: the scan's numbers against dense textbook formulae, its places
against virtual machines.
"""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy import special, stats

from kernel import gap_problem as case
from kernel.cases import CASES, reading_series
from kernel.gap_problem import Machines, first
from oed.gap.data.metric import Embedding
from oed.gap.data.problem import assemble
from oed.gap.data.tail import log_tail
from oed.gap.place import scan, session
from oed.gap.place.family import all_regions
from oed.gap.place.legs import ALL
from oed.gap.place.locate import locate
from oed.gap.place.regions import Region
from oed.gap.place.scan import Scan
from oed.noise.law import stated_law

KINDS = ("leg", "run", "time", "phase", "direction")


@pytest.fixture(scope="module")
def machines() -> Machines:
    problem = case.circles()
    return Machines(problem, case.law(problem))


# -- the numbers -----------------------------------------------------------------------


def test_statistic_and_its_p_value_are_those_of_generalised_least_squares(
    rng: np.random.Generator,
) -> None:
    problem = case.circles()
    law = case.law(problem)
    covariance = case.dense(problem, law)
    r = 3.0 * rng.standard_normal(len(problem))
    bases = [
        rng.standard_normal((len(problem), k)) * 10.0 ** rng.uniform(-3, 3)
        for k in (1, 4, 4)
    ]
    looks = [Region("x", "", basis) for basis in bases]
    root = Embedding(problem, law)
    region_scan = Scan(root, looks, root.scores(r)[:, None])
    energy = region_scan.energy[:, 0]
    log_p = log_tail(energy, region_scan.rank)
    assert_allclose(
        region_scan.log_least(region_scan.energy, np.ones(3, dtype=bool)),
        log_p.min(),
    )
    for look, e, p in zip(looks, energy, log_p, strict=True):
        B, MB = look.basis, np.linalg.solve(covariance, look.basis)
        expected = r @ MB @ np.linalg.solve(B.T @ MB, MB.T @ r)
        assert_allclose(e, expected, rtol=1e-6)
        assert_allclose(p, stats.chi2.logsf(expected, B.shape[1]), rtol=1e-6)
    assert_allclose(
        root.scores(r) @ root.scores(r), r @ np.linalg.solve(covariance, r), rtol=1e-6
    )


def test_what_the_parameters_can_absorb_is_no_column(rng: np.random.Generator) -> None:
    problem = case.circles()
    root = Embedding(problem, stated_law(problem))
    k = problem.names.index("dq1")
    assert np.linalg.norm(problem.slopes[:, k]) > 1000.0
    other = rng.standard_normal(len(problem))
    basis = np.column_stack(
        [problem.slopes[:, k], other, problem.slopes[:, k] + 1e-6 * other]
    )
    assert Scan(root, [Region("x", "", basis)], basis).rank[0] == 1


@pytest.mark.parametrize("rank", [1.0, 2.0, 5.0, 14.0])
def test_far_tails_do_not_underflow(rank: float) -> None:
    near = np.array([0.0, 1.0, 30.0, 500.0])
    assert_allclose(
        log_tail(near, rank), stats.chi2.logsf(near, rank), rtol=1e-9, atol=1e-12
    )
    # beyond, the tail's recurrence Q(a + 1, x) = Q(a, x) + x^a e^-x / Gamma(a + 1),
    # whose second term dominates
    x = 2000.0
    a, b = log_tail(np.array(2 * x), rank), log_tail(np.array(2 * x), rank + 2.0)
    added = rank / 2.0 * np.log(x) - x - float(special.gammaln(rank / 2.0 + 1.0))
    assert_allclose(b, np.logaddexp(a, added), rtol=1e-8)
    assert log_tail(np.array(3.0), 0.0) == 0.0


def test_corrected_p_values_are_those_of_a_bootstrap_that_fits_again() -> None:
    """Reading by reading: draw machines and noise, look everywhere, take the least
    p-value.
    """
    problem = case.circles(12, (1.10, 1.22))
    law = case.law(problem)
    covariance = case.dense(problem, law)
    rng = np.random.default_rng(5)
    r = np.linalg.cholesky(covariance) @ rng.standard_normal(len(problem))
    r += case.sized(
        case.in_joint(problem, 1, 1e-6 * problem.states[0].motion_sign[:, 1]),
        covariance,
        4.5,
    )
    by_block = {
        b.block: b.p_value
        for b in locate(problem.with_residual(r), law, rng, draws=2000)
    }
    looks = list(all_regions(problem))
    inverse = np.linalg.inv(covariance)
    drawn = rng.multivariate_normal(
        np.zeros(len(problem)), covariance, size=400, method="eigh"
    )
    values = np.vstack([r, drawn])
    p_values = np.empty((len(looks), len(values)))
    quiet = np.linalg.inv(covariance - problem.slopes @ problem.slopes.T)
    for k, look in enumerate(looks):
        size = np.sqrt(np.einsum("nk,nm,mk->k", look.basis, quiet, look.basis))
        B = look.basis / np.where(size > 0.0, size, 1.0)
        inner, vectors = np.linalg.eigh(B.T @ inverse @ B)
        regular = vectors[:, inner > scan.SURVIVES] / np.sqrt(
            inner[inner > scan.SURVIVES]
        )
        explained = np.square(regular.T @ (B.T @ (inverse @ values.T))).sum(axis=0)
        p_values[k] = (
            stats.chi2.sf(explained, regular.shape[1]) if regular.size else 1.0
        )
    least = p_values[:, 1:].min(axis=0)
    place = {
        name: min(p_values[k, 0] for k, look in enumerate(looks) if look.place == name)
        for name in ("leg 1", "leg 2")
    }
    for name, p in place.items():
        expected = np.mean(least <= p)
        assert abs(by_block[name] - expected) < 4.0 * np.sqrt(
            max(expected * (1 - expected), 0.01) / 400
        )


def test_false_alarms_are_as_stated(machines: Machines) -> None:
    """400 sets without a gap, drawn with dense matrices, against one bootstrap: the
    least p-value is uniform.
    """
    rng, problem = np.random.default_rng(11), machines.problem
    root = Embedding(problem, machines.law)
    drawn = rng.standard_normal((len(problem), 500))
    quiet = root.scores(machines.root @ rng.standard_normal((len(problem), 400)))
    family = Scan(root, all_regions(problem), np.hstack([drawn, quiet]))
    drawn, quiet = np.split(family.energy, [500], axis=1)
    least = family.log_least(drawn, np.ones(len(drawn), dtype=bool))
    least_p = [
        scan._against_least(log_tail(e, family.rank), least).min() for e in quiet.T
    ]
    assert (
        6 <= np.sum(np.array(least_p) <= 0.05) <= 36
    )  # 20 expected, both samplings' spread three times over
    assert stats.kstest(least_p, "uniform").pvalue > 0.002


def test_false_alarms_of_the_whole_call(machines: Machines) -> None:
    rng = np.random.default_rng(12)
    assert (
        sum(
            min(b.p_value for b in machines.located(None, 0.0, rng)) <= 0.05
            for _ in range(30)
        )
        <= 6
    )


# -- the places ------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["sense", "wave", "bend", "warm"])
def test_effect_in_one_leg_is_found_there(machines: Machines, form: str) -> None:
    rng = np.random.default_rng(2)
    state = machines.problem.states[0]
    right = []
    for k in range(12):
        limb, q = k % 3, state.joints[:, k % 3]
        u = (q - q.min()) / np.ptp(q)
        change = {
            "sense": state.motion_sign[:, limb],
            "wave": np.cos(
                2.0 * np.pi * u * rng.uniform(3.0, 12.0) + rng.uniform(0.0, 6.0)
            ),
            "bend": np.sign(u - 0.5) * np.abs(u - 0.5) ** 1.5,
            "warm": np.exp(-state.time / 300.0),
        }[form]
        blocks = machines.located(
            case.in_joint(machines.problem, limb, 1e-6 * change), 8.0, rng
        )
        right.append(first(blocks, "leg") == f"leg {limb + 1}")
        assert blocks[0].p_value < 0.05
    assert np.mean(right) >= 11 / 12


def test_the_same_change_in_all_legs_is_told_as_that(
    machines: Machines, rng: np.random.Generator
) -> None:
    state = machines.problem.states[0]
    change = sum(
        case.in_joint(machines.problem, k, 1e-6 * state.motion_sign[:, k])
        for k in range(3)
    )
    blocks = machines.located(change, 12.0, rng)
    assert blocks[0].block == ALL
    assert {b.block for b in blocks} >= {"leg 1", "leg 2", "leg 3"}
    one = machines.located(
        case.in_joint(machines.problem, 1, 1e-6 * state.motion_sign[:, 1]), 12.0, rng
    )
    assert ALL not in {b.block for b in one}


def test_fault_in_one_run_is_found_there(machines: Machines) -> None:
    rng = np.random.default_rng(4)
    problem, right = machines.problem, 0
    for k in range(12):
        members = problem.members[k % 6]
        change = np.zeros(len(problem))
        change[members] = np.cos(
            problem.rows["phase"].to_numpy()[members] + rng.uniform(0.0, 6.0)
        )
        blocks = machines.located(change, 8.0, rng)
        right += first(blocks, "run") == f"run {problem.rows['run'][members[0]]}"
    assert right >= 11


@pytest.mark.parametrize("limb", [None, 0, 2])
def test_step_is_found_at_its_time(machines: Machines, limb: int | None) -> None:
    rng = np.random.default_rng(6)
    problem, state = machines.problem, machines.problem.states[0]
    missed = []
    for start in np.linspace(150.0, 700.0, 8):
        change = (problem.rows["time"].to_numpy() >= start).astype(float)
        if limb is not None:
            change = case.in_joint(problem, limb, 1e-6 * (state.time >= start))
        blocks = machines.located(change, 14.0, rng)
        begin, end = (
            float(v) for v in first(blocks, "time").removeprefix("time ").split("-")
        )
        missed.append(abs(begin - start))
        assert end == problem.rows["time"].max()
    assert np.median(missed) <= 6.0  # one reading: 6 s
    assert np.max(missed) <= 60.0


def test_shift_for_a_while_is_told_with_both_ends(
    machines: Machines, rng: np.random.Generator
) -> None:
    time = machines.problem.rows["time"].to_numpy()
    blocks = machines.located(
        ((time >= 348.0) & (time <= 510.0)).astype(float), 14.0, rng
    )
    begin, end = (
        float(v) for v in first(blocks, "time").removeprefix("time ").split("-")
    )
    assert abs(begin - 348.0) <= 18.0
    assert abs(end - 510.0) <= 18.0


def test_a_stretch_ends_halfway_to_the_readings_beside_it(machines: Machines) -> None:
    """When a fault came and went nobody saw, but it was between two readings; the
    session's ends are its own.
    """
    rows = machines.problem.rows
    late = rows["time"] + 600.0 * rows["run"].ne(rows["run"].shift()).cumsum()
    problem = dataclasses.replace(machines.problem, rows=rows.assign(time=late))
    inside, time = problem.members[3], late.to_numpy(dtype=float)
    places = {
        w.place
        for w in session.window(
            problem, time[inside].min(), time[inside].max(), frozenset({1})
        )
    }
    before, after = time[problem.members[2]].max(), time[problem.members[4]].min()
    begin, end = 0.5 * (before + time[inside].min()), 0.5 * (time[inside].max() + after)
    assert after - end > 290.0
    assert places == {f"time {begin:.0f}-{end:.0f}"}
    whole = {
        w.place for w in session.window(problem, time.min(), time.max(), frozenset({1}))
    }
    assert whole == {f"time {time.min():.0f}-{time.max():.0f}"}


def test_bump_in_the_phase_is_found_there_over_the_start_too(
    machines: Machines, rng: np.random.Generator
) -> None:
    phase = np.rad2deg(machines.problem.rows["phase"].to_numpy())
    bump = ((phase >= 330.0) | (phase < 30.0)).astype(float)
    assert first(machines.located(bump, 14.0, rng), "phase") == "phase 330-30"


@pytest.mark.parametrize(("limb", "other"), [(0, 1), (2, 0)])
def test_a_leg_disturbed_by_anothers_motion_is_that_leg(
    machines: Machines, rng: np.random.Generator, limb: int, other: int
) -> None:
    change = case.in_joint(
        machines.problem, limb, 1e-6 * machines.problem.states[0].motion_sign[:, other]
    )
    legs = [first(machines.located(change, 10.0, rng), "leg") for _ in range(5)]
    assert legs.count(f"leg {limb + 1}") >= 4


def test_fault_in_one_direction_is_found(
    machines: Machines, rng: np.random.Generator
) -> None:
    rows = machines.problem.rows
    change = (rows["direction"] == -1) * np.cos(2.0 * rows["phase"] + 1.0)
    p_values = {
        b.block: b.p_value for b in machines.located(change.to_numpy(), 14.0, rng)
    }
    assert min(p_values["direction +1"], p_values["direction -1"]) < 1e-6


def test_what_the_calibration_absorbs_is_nowhere(
    machines: Machines, rng: np.random.Generator
) -> None:
    problem = machines.problem
    r = (
        machines.root @ rng.standard_normal(len(problem))
        + 3.0 * problem.slopes[:, problem.names.index("dq2")]
    )
    assert np.abs(r).max() > 1000.0
    assert locate(problem.with_residual(r), machines.law, rng)[0].p_value > 0.05


def test_same_seed_same_places_sorted_and_told_once(machines: Machines) -> None:
    a, b = (machines.located(None, 0.0, np.random.default_rng(3)) for _ in range(2))
    assert a == b
    assert [x.p_value for x in a] == sorted(x.p_value for x in a)
    assert len({x.block for x in a}) == len(a)
    assert all(0.0 <= x.strength <= 1.0 and 0.0 < x.p_value <= 1.0 for x in a)
    assert {kind for kind in KINDS if any(x.block.startswith(kind) for x in a)} == set(
        KINDS
    )


@pytest.mark.parametrize(
    ("machine", "setup"),
    [
        ("hexapod", "camera"),
        ("prs_spindle", "pose_tracker"),
        ("planar_2dof", "rm3"),
        ("cable_robot", "redundancy"),
    ],
)
def test_readings_without_covariates_and_with_several_channels(
    machine: str, setup: str, rng: np.random.Generator
) -> None:
    measurement, series = reading_series(CASES[machine], setup, rng, 40)
    labels = np.array([f"r{k // 10}" for k in range(len(series))])
    if measurement.setups[setup].instrument.reference != "run":
        series = dataclasses.replace(series, run=labels)
    order = pd.Series(series.run).groupby(series.run).cumcount() + 2
    table = pd.DataFrame({"setup": setup, "run": series.run, "order": order})
    problem = assemble(measurement, [series], table)
    r = problem.residual + rng.standard_normal(len(problem))
    blocks = locate(problem.with_residual(r), stated_law(problem), rng, draws=100)
    names = {b.block for b in blocks}
    assert {f"leg {k + 1}" for k in problem.states[0].limbs} <= names
    assert not any(n.startswith(("time", "direction")) for n in names)
    hit = r.copy()
    hit[problem.members[1]] += 30.0 * rng.standard_normal(len(problem.members[1]))
    blocks = locate(problem.with_residual(hit), stated_law(problem), rng, draws=100)
    assert first(blocks, "run") == f"run {problem.rows['run'][problem.members[1][0]]}"
