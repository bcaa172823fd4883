"""Covariates, poses and zeros of instruments that no workshop has, and what they may mean."""

import itertools

import blunder_machines as machines
import numpy as np
import pytest
from blunder_spatial import prs_poses
from blunder_table import interpolated, two_digits_exchanged

from oed.checks import check, copies
from oed.checks.explain import candidates
from oed.checks.mistakes import Suspect, amounts, noise, tools
from oed.checks.screening import Screening
from oed.dataset import ReadingsError, column_meanings
from oed.model import Coordinate

DEG = np.pi / 180.0


@pytest.mark.parametrize(("column", "value", "words"), [
    ("temp_platform_C", 293.15, "kelvin, not Celsius"),
    ("temp_platform_C", -300.0, "below absolute zero"),
    ("temp_platform_C", 9999.0, "no value"), ("payload_N", 1e9, "0 to 100000 N"),
    ("payload_N", -100.0, "cannot be negative"),
    ("feed_mm_min", 1e6, "0 to 300000 mm_min"),
])  # fmt: skip
def test_a_covariate_no_workshop_has_is_doubted_by_row(column, value, words):
    rows = machines.readings("a3", 0).assign(**{column: 20.0})
    rows.loc[[3, 9], column] = value
    (finding,) = check.doubtful_conditions(machines.session("a3", rows))
    assert finding.rows == (5, 11)
    assert words in finding.sentence
    assert column in finding.sentence


def test_usual_covariates_are_not_doubted():
    """A workshop at -5 C, a head of 60 C, a feed of 60 m/min, a load of 500 kg."""
    rows = machines.readings("a3", 0).assign(
        temp_base_C=-5.0, temp_platform_C=60.0, feed_mm_min=6e4, payload_N=4905.0
    )
    rows.loc[4, "temp_base_C"] = np.nan
    assert not check.doubtful_conditions(machines.session("a3", rows))


def test_notations_of_an_angle_are_those_of_a_calculator():
    theta = Coordinate("theta", "rad", 0.0, 40.0 * DEG)
    file = np.array([30.3045, 12.1530, 5.5900]) * DEG
    meant = {words: f(file) / DEG for words, f in column_meanings(theta, file).items()}
    of_minutes = meant["{} has minutes and seconds after its decimal point"]
    in_hand = [30 + 30 / 60 + 45 / 3600, 12 + 15 / 60 + 30 / 3600, 5 + 59 / 60]
    assert of_minutes == pytest.approx(in_hand, abs=1e-9)
    assert meant["{} is in grad, not in deg"][0] == pytest.approx(27.27405)
    assert meant["{} is counted from the other axis, as 90 deg less it"][0] == (
        pytest.approx(59.6955)
    )
    from_the_end = meant["{} is counted from the other end of its values"]
    assert from_the_end == pytest.approx([5.59, 23.7415, 30.3045])


def test_no_minutes_are_read_from_more_than_sixty():
    theta = Coordinate("theta", "rad", 0.0, 40.0 * DEG)
    meant = column_meanings(theta, np.array([30.75, 12.15]) * DEG)
    assert not [words for words in meant if "minutes" in words]


def test_poses_out_of_the_workspace_say_what_their_column_may_mean(tmp_path):
    rows = machines.readings("a3", 0)
    rows["theta_deg"] = 90.0 - rows["theta_deg"]
    with pytest.raises(ReadingsError, match="theta_deg is counted from the other axis"):
        machines.session("a3", rows)


def test_three_rows_half_way_between_their_neighbours_are_interpolated():
    rows = machines.readings("a3", 0)
    session = machines.session("a3", interpolated(rows))
    found = copies.interpolated_readings(session)
    assert session.rows(found) == (10, 22, 35)
    assert not copies.interpolated_readings(machines.session("a3", rows)).size


def test_exchanged_digits_are_named_with_the_number_that_fits():
    rows = machines.readings("a3", 0)
    right = rows.loc[20, "length_mm"]
    checked = machines.check("a3", two_digits_exchanged(rows))
    (finding,) = [f for f in checked.findings if f.kind == "outlier"]
    assert finding.rows == (22,)
    assert f"digits exchanged it is {right:.9g}" in finding.sentence


@pytest.mark.parametrize("pair", [(0, 2)])
def test_any_runs_of_a_set_up_may_have_one_mistake(pair):
    """The likeliest mistake in the linear model is that which was made, and where."""
    rows = machines.readings("planar", 0)
    names = list(dict.fromkeys(rows["run"]))
    wrong = rows["run"].isin([names[k] for k in pair])
    rows.loc[wrong, "dy_mm"] *= 0.1
    given = Suspect(machines.session("planar", rows))
    first, _ = candidates(given, Screening(given), thorough=True)
    likeliest = first[0].trial
    at = given.session.values["run"].isin([names[k] for k in pair])
    assert likeliest.kind == "scale"
    inside = np.isin(given.session.reading_of_value, likeliest.scope.readings)
    assert np.array_equal(inside, at)


def test_the_stated_noise_is_doubted_where_readings_fit_a_thousand_times_better():
    given = Suspect(machines.session("a3", machines.readings("a3", 0)))
    (trial,) = [t for t in noise.noise_trials(given) if t.noise.max() == 1e3]
    (other,) = trial.undo(trial.amounts)
    assert other.noise().sigma == pytest.approx(1e3 * given.sigma)


def test_a_rounded_command_is_noise_of_its_slope():
    """Variance of a uniform error of one degree: a twelfth, times the slope squared."""
    rows = machines.readings("a3", 0)
    rows["theta_deg"] = rows["theta_deg"].round()
    given = Suspect(machines.session("a3", rows))
    trial = next(
        t
        for t in noise.trials(given)
        if t.text(t.amounts, t.amounts)
        == "theta_deg is rounded to 1: finer numbers were driven"
    )
    moved = rows.assign(theta_deg=rows["theta_deg"] + 0.01)
    slope = (Suspect(machines.session("a3", moved)).predicted - given.predicted) / 0.01
    variance = given.sigma**2 + slope**2 / 12.0
    (other,) = trial.undo(trial.amounts)
    assert other.noise().sigma == pytest.approx(np.sqrt(variance), rel=1e-2)


def test_each_run_has_an_offset_of_its_own():
    rows = machines.readings("planar", 0)
    given = Suspect(machines.session("planar", rows))
    trial = next(
        t
        for t in amounts.trials(given)
        if t.family == "offsets dy " and t.columns is not None
    )
    made = np.arange(len(trial.amounts)) * 1e-4
    (other,) = trial.undo(made)
    taken = given.session.y - other.y
    by_run = {
        run: taken[(given.session.values["run"] == run) & (given.channel == "dy")]
        for run in dict.fromkeys(rows["run"])
    }
    for run, amount in zip(by_run, made, strict=True):
        assert by_run[run] == pytest.approx(amount)


def test_a_tool_point_beside_the_axis_is_read_there():
    """By the instrument's own model, with the tool of the set-up where it was."""
    session = machines.session("prs", machines.readings("prs", 0))
    given = Suspect(session)
    trial = next(
        t
        for t in tools.trials(given)
        if t.text(np.ones(1), np.ones(1)).startswith("the point that is read")
        and " in x " in t.text(np.ones(1), np.ones(1))
        and len(t.amounts) == 1
    )
    (other,) = trial.undo(np.array([0.025]))
    setup = other.measurement.setups[other.series[0].setup]
    (before,) = session.measurement.setups.values()
    assert np.array(setup.tool) - np.array(before.tool) == pytest.approx([0.025, 0, 0])


PAIRS = [
    f"length_mm of {one}; length_mm of {other}"
    for one, other in itertools.combinations(("cup", "long_tool", "mid_tool"), 2)
]


@pytest.mark.parametrize(("machine", "names"), [
    ("a3", []),
    ("hexapod", []),
    ("planar", ["dz_mm of ruler; dy_mm of square"]),
    ("a3 in three set-ups", PAIRS),
])  # fmt: skip
def test_where_one_instrument_may_have_been_used(machine, names):
    """Not in all channels or set-ups of the file: that is a mistake of the file."""
    session = machines.session(machine, machines.readings(machine, 0))
    scopes = Suspect(session).instruments
    wanted = [f"one instrument ({name})" for name in names]
    assert [scope.name for scope in scopes] == wanted
    for scope in scopes:
        readings = np.unique(session.reading_of_value[scope.values])
        assert np.array_equal(readings, scope.readings)


@pytest.mark.parametrize(("name", "axis"), [("range", 0), ("elevation", 1)])
def test_slopes_over_an_inner_zero_are_those_of_another_code(name, axis):
    rows = machines.readings("prs", 0)
    given = Suspect(machines.session("prs", rows))
    trial = next(t for t in amounts.trials(given) if f"zero {name} " in t.family)
    q, p, shift, turn, error = rows.attrs["machine"]
    nominal = (q, 0.0 * p, 0.0 * shift, 0.0 * turn)
    step = np.zeros_like(error)
    step[:, :, axis] = 1e-5
    by_steps = prs_poses(*nominal, step) - prs_poses(*nominal, -step)
    assert trial.columns[:, 0] == pytest.approx(by_steps.ravel() / 2e-5, abs=1e-5)


def test_an_instrument_without_inner_readings_has_no_such_zero():
    given = Suspect(machines.session("planar", machines.readings("planar", 0)))
    families = [trial.family for trial in amounts.trials(given)]
    assert not [name for name in families if name.startswith("zero ")]
