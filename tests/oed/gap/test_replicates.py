"""Readings taken again, far off, or of places that a gap can be in at all."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats
from shipped_models import backlash, encoder_scale, friction, planar_2dof, pose_tracker

from kernel import gap_lines
from kernel.gap_lines import readings, white_lines
from kernel.laws import STATED_LAW, draw_noise, noise_law
from oed import Measurement, mount
from oed.effect_model import UNKNOWN_SIZES
from oed.gap import GapProblem, diagnose, prepare
from oed.gap import procedure as diagnosing
from oed.gap.cause import locations
from oed.gap.cause.compare import Comparison, compare
from oed.gap.cause.locations import STANDING_OUT, LikelyForms, ReversedForms
from oed.gap.cause.scatter import Energies, replicates, shape
from oed.gap.cause.searches import detect_outliers
from oed.gap.data import problem as problems
from oed.gap.data.diagnosis import AGAIN, ON_THE_SPOT, Diagnosis
from oed.gap.forms import discrepancy, library
from oed.measurement import draw_parameters, draw_readings
from oed.result import PlaceRecord

effect = encoder_scale.effect
position = pose_tracker.position
machine = planar_2dof.machine

SIGMA = 10e-6
POSES, TIMES = 15, 3


def problem(recurring, *, on_the_spot, loud_run=1.0, seed=3):
    """Of poses at random read three times, with errors that recur, in noise units."""
    rng = np.random.default_rng(seed)
    measurement = Measurement(machine, [mount(position, "tracker", sigma=(SIGMA,) * 3)])
    poses = np.column_stack(
        [rng.uniform(-1.2, 1.2, 2 * POSES), rng.uniform(0.2, 1.3, 2 * POSES)]
    )
    errors = recurring * SIGMA * rng.standard_normal((2 * POSES, 3))
    once = np.arange(2 * POSES)
    numbers = np.repeat(once, TIMES) if on_the_spot else np.tile(once, TIMES)
    runs = np.repeat([str(k) for k in range(6)], POSES)
    series = measurement.series("tracker", poses[numbers], runs)
    noise = SIGMA * rng.standard_normal((len(numbers), 3))
    noise[runs == "4"] *= loud_run
    y = measurement.readings([series], measurement.nominal)
    y = y + (errors[numbers] + noise).ravel()
    order = np.tile(np.arange(1, POSES + 1), 6)
    covariates = pd.DataFrame({"setup": "tracker", "run": runs, "order": order})
    return prepare(measurement, [series], y, covariates)


def test_what_differs_between_readings_taken_again_is_the_variance_within_poses():
    of = problem(3.0, on_the_spot=False)
    again = replicates(of)
    assert not again.on_the_spot
    energy, freedom = again.energy(of, STATED_LAW)
    by_pose = of.residual.reshape(TIMES, 2 * POSES, 3)
    expected = ((by_pose - by_pose.mean(axis=0)) ** 2).sum()
    assert energy == pytest.approx(expected, rel=1e-9)
    assert freedom == (TIMES - 1) * 2 * POSES * 3


def test_long_sessions_count_some_of_their_poses(monkeypatch):
    of = problem(3.0, on_the_spot=False)
    monkeypatch.setattr("oed.gap.cause.scatter.MAX_POSES", 20)
    again = replicates(of)
    _, freedom = again.energy(of, STATED_LAW)
    assert len(again.rows) == TIMES * 20
    assert freedom == (TIMES - 1) * 20


def test_the_evidence_of_what_recurs_is_the_integral_over_the_noise_level():
    parts = Energies(18.0, 20, 60.0, 30)

    def density(variance: float, inflation: float) -> float:
        prior = stats.invgamma.pdf(variance, 2.0, scale=2.0)
        pure = stats.chi2.pdf(parts.pure / variance, parts.pure_freedom)
        of_rest = inflation * variance
        rest = stats.chi2.pdf(parts.rest / of_rest, parts.rest_freedom)
        return float(prior * pure / variance * rest / of_rest)

    none = integrate.quad(density, 0.05, 20.0, args=(1.0,))[0]
    prior = np.exp(UNKNOWN_SIZES.log_visible_shares(np.array([30.0])))[0]
    rough = sum(
        share * integrate.quad(density, 0.05, 20.0, args=(1.0 + size**2,))[0]
        for size, share in zip(UNKNOWN_SIZES.values, prior, strict=True)
        if share > 0.0
    )
    assert parts.log_evidence == pytest.approx(np.log(rough / none), rel=1e-4)


@pytest.mark.parametrize(("on_the_spot", "against", "words"), [
    (False, AGAIN, "what recurs in runs"),
    (True, ON_THE_SPOT, "take the same run again"),
])  # fmt: skip
def test_errors_that_recur_at_each_pose_are_no_noise(on_the_spot, against, words):
    of = problem(1.2, on_the_spot=on_the_spot)
    result = diagnose(of, [effect], np.random.default_rng(1))
    assert result.verdict == "scatter"
    assert result.scatter.against == against
    expected = np.sqrt(1.0 + TIMES * 1.2**2)
    assert result.scatter.factor == pytest.approx(expected, rel=0.2)
    assert words in result.next[0]


def test_the_same_scatter_without_a_recurring_part_is_noise():
    of = problem(0.0, on_the_spot=False)
    assert diagnose(of, [effect], np.random.default_rng(1)).verdict == "none"


def test_a_run_that_scatters_more_is_named():
    of = problem(0.0, on_the_spot=False, loud_run=2.5)
    assert shape(of, STATED_LAW) == "run 4"
    assert shape(problem(0.0, on_the_spot=False), STATED_LAW) == "white"


def diagnosis(factor: float, *, assumed: bool = False) -> Diagnosis:
    """Of 48 poses whose readings scatter a factor of the stated noise, without effects."""
    setup = mount(position, "tracker", sigma=(SIGMA,) * 3)
    statement = dataclasses.replace(setup.statement, is_assumed=assumed)
    setup = dataclasses.replace(setup, statement=statement)
    measurement = Measurement(machine, [setup])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 8), np.linspace(0.2, 1.3, 6))
    runs = np.repeat([str(k) for k in range(6)], 8)
    command = np.column_stack([y.ravel(), z.ravel()])
    series = measurement.series("tracker", command, runs)
    rng = np.random.default_rng(7)
    noise = factor * SIGMA * rng.standard_normal(3 * len(command))
    readings = measurement.readings([series], measurement.nominal) + noise
    order = np.tile(np.arange(1, 9), 6)
    rows = {"setup": "tracker", "run": runs, "order": order, "direction": 1}
    covariates = pd.DataFrame(rows)
    problem = prepare(measurement, [series], readings, covariates)
    return diagnose(problem, [effect], rng)


def test_scatter_that_a_data_sheet_is_good_for_is_noise():
    result = diagnosis(1.3)
    assert result.verdict == "none"
    assert result.scatter is None
    assert "compensate the geometry" in result.next[0]


def test_more_scatter_is_reported_with_its_factor_and_no_go_ahead():
    result = diagnosis(3.0)
    assert result.verdict == "scatter"
    assert result.scatter.factor == pytest.approx(3.0, rel=0.2)
    assert result.next[0].startswith("Do not compensate yet: read some poses several")
    assert result.where == ()


def test_an_assumed_noise_is_no_data_sheet():
    assert diagnosis(3.0, assumed=True).verdict == "none"


def grid_problem(noise: float) -> GapProblem:
    sigma = np.full(3, noise)
    measurement = Measurement(machine, [mount(position, "tracker", sigma=sigma)])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    rng = np.random.default_rng(1)
    truth = draw_parameters(measurement, rng)
    readings = draw_readings(measurement, [series], truth, rng)
    covariates = pd.DataFrame(
        {"setup": "tracker", "run": "1", "order": np.arange(25), "direction": 1}
    )
    return prepare(measurement, [series], readings, covariates)


@pytest.mark.parametrize(("norm", "tested"), [(3.0, True), (0.1, True), (0.003, False)])
def test_an_effect_is_tested_where_its_usual_sizes_show(norm, tested):
    """By the norm over all readings of what it changes at its expected size."""
    quiet = grid_problem(1e-6)
    (constants,) = effect.constant_grid()
    columns = quiet.signature(effect, constants).columns
    noise = float(np.linalg.norm(columns)) / norm
    built = library.build(grid_problem(noise), [effect])
    assert (effect.name not in built.not_testable) == tested


def _named(diagnosis: Diagnosis) -> dict[str, PlaceRecord]:
    """Places that stand out, by name, the first first."""
    return {b.block: b for b in diagnosis.where if b.p_value < STANDING_OUT}


def _under_stated_noise(problem, effects) -> Diagnosis:
    """The noise that the readings are drawn with is known: no search over noise laws."""
    rng = np.random.default_rng(1)
    return diagnosing.diagnose(problem, effects, rng, law=STATED_LAW)


def test_an_effect_alike_both_ways_is_in_no_direction():
    """One way is read at other heights than the other, so that it shows more there."""
    lines = gap_lines.readings(1, heights=lambda way, k: 0.4 * k if way > 0 else 0.0)
    problem = gap_lines.planted(lines, gap_lines.BOW, {"leg 1": 4.0}, turns=3.0)
    diagnosis = _under_stated_noise(problem, gap_lines.EFFECTS)
    assert "bow" in diagnosis.answers[0].effects
    for block in diagnosis.where:
        if block.block.startswith("direction"):
            assert block.strength == pytest.approx(0.5, abs=1e-6)
            assert block.p_value > 0.5
    assert not any(name.startswith("direction") for name in _named(diagnosis))


def test_columns_driven_the_other_way_change_their_sign_where_the_effect_does():
    """A bow of the joints stays as it is, slip of the drives turns about."""
    problem = gap_lines.readings(1)
    search = gap_lines.search_of(problem, processes=discrepancy.build(problem))
    other_way = ReversedForms(
        problem, search.library, search.processes, gap_lines.EFFECTS
    )
    for effect, sign in (("bow", 1.0), ("slip", -1.0)):
        atom = search.library.atoms_of(effect)[0]
        h = search.fit((effect,), (atom,), (1.0,))
        columns = h.columns(search.library, search.processes)
        turned = other_way.columns(h, 1.0)
        same = np.isclose(turned, sign * columns).all(axis=1)
        assert (
            same.mean() > 0.95
        )  # at the ends of a line a joint arrives from either side


def test_a_discrepancy_of_one_direction_is_not_there_the_other_way():
    problem = gap_lines.readings(1)
    search = gap_lines.search_of(problem, (), discrepancy.build(problem))
    other_way = ReversedForms(problem, search.library, search.processes, ())
    empty = search.fit((), (), ())
    kinds = set()
    for number, atom in enumerate(search.processes.atoms):
        if number % 10:  # a tenth of them: each kind has many
            continue
        kinds.add(atom.effect)
        h = empty.with_form(0, number, 1.0)
        columns = h.columns(search.library, search.processes)
        turned = other_way.columns(h, 1.0)
        both = "different each way" in atom.about
        if atom.effect == discrepancy.WITH_DIRECTION and not both:
            assert turned == pytest.approx(-columns)
        elif atom.effect == discrepancy.ALONG_RUNS or both:
            # with both halves: a bump in one direction alone has the other's sign
            assert turned != pytest.approx(columns)
            assert turned**2 == pytest.approx(columns**2)
        else:
            assert turned == pytest.approx(columns)
    assert kinds == {atom.effect for atom in search.processes.atoms}


def test_a_worn_place_of_a_leg_is_no_backlash_beside_something():
    """A bump of a leg, twice as high one way as the other, is of one unknown."""
    problem = gap_lines.readings(3)
    places = discrepancy.values_of_poses(problem, [s.joints for s in problem.states])
    senses = discrepancy.values_of_poses(
        problem, [s.motion_sign for s in problem.states]
    )
    leg = places[..., 0]
    width = 0.2 * np.ptp(leg)
    bump = np.exp(-(((leg - leg.mean()) / width) ** 4)) * (1.0 + senses[..., 0] / 3.0)
    _, joints, *_ = discrepancy.carriers_of(problem)
    column = joints.columns[:, 0, None]
    change = discrepancy.apply_carrier(column, bump[..., None])[:, 0, 0]
    change *= 3.0 / np.sqrt(np.mean(change**2))
    acting = problem.with_residual(problem.residual + change)
    effects = (backlash.effect, friction.effect)
    searches = [gap_lines.search_of(acting, effects, discrepancy.build(acting))]
    comparison = Comparison(tuple(searches), tuple(compare(searches)))
    diagnosis, best = diagnosing.conclude(comparison, effects)
    assert best.key == (frozenset(), True)
    assert next(iter(diagnosis.likeness)) == (
        "an error of leg 1 over the workspace, different each way"
    )


def test_a_leg_that_moved_in_one_stretch_alone_is_that_stretch():
    """Leg 1 stands still but for the second of three runs."""
    measurement = Measurement(planar_2dof.machine, [mount(position, "tracker")])
    each = 12
    x, rest = measurement.kinematics.inverse(np.array([[0.0, 0.7]]))
    along, still = np.linspace(-0.2, 0.2, each), np.zeros(each)
    first = np.concatenate([still, along, still])
    second = np.concatenate([along, still, -along])
    q = rest + np.column_stack([first, second])
    start = np.tile(x, (len(q), 1))
    poses = measurement.kinematics.forward(q, planar_2dof.machine.nominal, start)
    runs = np.repeat(["a", "b", "c"], each)
    series = measurement.series("tracker", poses, runs.tolist())
    order = np.tile(np.arange(each), 3)
    times = 60.0 * np.arange(len(q))
    rows = {"setup": "tracker", "run": runs, "order": order, "time": times}
    problem = problems.assemble(measurement, [series], pd.DataFrame(rows))
    inside = (problem.rows["run"] == "b").to_numpy()
    column = inside * np.sin(np.arange(len(problem)))
    change = column[:, None] * 50.0
    model = LikelyForms(1.0, change, ["leg 1"], np.array([True]))
    readings = problem.with_residual(change[:, 0])
    law = STATED_LAW
    places = locations.locate(readings, law, [model], np.random.default_rng(1))
    same = {p.block: p.same_as for p in places}
    assert same["run b"] == "leg 1"
    assert [p.same_as for p in places if p.block.startswith("time")] == ["run b"]


def test_normal_readings_have_no_strays():
    """In at most one set of twelve: the likeliest shape must be worth a factor of twenty."""
    detected = [
        detect_outliers(p, STATED_LAW, p.slopes)
        for p in (white_lines(k, 5, 31) for k in range(12))
    ]
    assert sum(f is not None for f in detected) <= 1


def test_strays_are_told_beside_a_model_of_many_columns():
    """Its columns give way to a stray by two thirds: it is still told by the others."""
    problem = white_lines(13, runs=5, length=31)
    columns, rng = _bumpy(problem, 18), np.random.default_rng(14)
    assert columns.shape[1] == 0.6 * len(problem)
    y = columns @ rng.standard_normal(columns.shape[1]) + rng.standard_normal(
        len(problem)
    )
    wide = np.hstack([problem.slopes, columns])
    assert detect_outliers(problem.with_residual(y), STATED_LAW, wide) is None
    far = rng.choice(len(problem), 9, replace=False)
    y[far] += 15.0 * rng.choice([-1.0, 1.0], len(far))
    detected = detect_outliers(problem.with_residual(y), STATED_LAW, wide)
    moved = np.abs(detected.pseudo_residual - y)
    assert moved[far].min() > 5.0
    assert np.quantile(np.delete(moved, far), 0.95) < 1.0


def test_a_stray_does_not_spoil_its_neighbours():
    """In an error that is carried along a reading is predicted from its neighbours."""
    problem = readings(3)
    law = noise_law(ar1_sd=2.0, ar1_length=8.0)
    y = draw_noise(problem, law, np.random.default_rng(4))
    far = np.arange(20, len(problem), 60)
    spoilt = y.copy()
    spoilt[far] += 20.0
    detected = detect_outliers(problem.with_residual(spoilt), law, problem.slopes)
    neighbours = np.concatenate([far - 2, far + 2])  # two channels are read by turns
    assert np.abs(detected.pseudo_residual - y)[neighbours].max() < 1.0
    assert np.abs(detected.pseudo_residual - y)[far].max() < 5.0


def _bumpy(problem: GapProblem, count: int) -> np.ndarray:
    """Columns (N, k) of `count` cosines of falling size in each channel of each run."""
    bumps = []
    for members in problem.members:
        for group in np.unique(problem.channel):
            mine = members[problem.channel[members] == group]
            at = (np.arange(len(mine)) + 0.5) / len(mine)
            for k in range(count):
                bumps.append(np.zeros(len(problem)))
                bumps[-1][mine] = np.cos(np.pi * k * at) / (1.0 + k / 4.0)
    return np.column_stack(bumps)
