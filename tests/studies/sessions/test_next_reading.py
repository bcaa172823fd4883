"""The best next reading: against direct inversion, with effects, and as the command tells it."""

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sample

from oed.design import Candidates
from pkm_studies import shipped
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.sessions import next_reading
from pkm_studies.sessions.next_reading import effects_at
from pkm_studies.stages import select_design
from pkm_studies.study import Study

STUDY = sample.changed(
    sample.STUDY, ("[design]", "[prediction]\nz_mm = 1146.0\npsi_deg = [0.0, 120.0]\ntheta_deg = 20.0\n\n[design]")
)  # fmt: skip


@pytest.fixture
def blocks() -> np.ndarray:
    return np.random.default_rng(6).standard_normal((20, 2, 6))


# -- command ---------------------------------------------------------------------------
@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "mine.study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.fixture
def readings(study: Path, tmp_path: Path) -> Callable[[int], Path]:
    """A file with the first readings of a virtual machine."""
    whole = tmp_path / "whole.readings.csv"
    assert main(["simulate", str(study), "--out", str(whole)]) == 0
    lines = whole.read_text(encoding="utf-8").splitlines()

    def first(count: int) -> Path:
        path = tmp_path / f"first_{count}.readings.csv"
        path.write_text("\n".join(lines[: count + 1]) + "\n", encoding="utf-8")
        return path

    return first


def test_each_reading_makes_the_machine_better_known(study, readings):
    adviser = next_reading.Adviser(Study.load(study))
    few, more = (adviser.advise(readings(count)) for count in (4, 9))
    assert (few.readings, more.readings) == (4, 9)
    assert (more.known <= few.known).all()
    assert (few.after <= few.known * (1.0 + 1e-9)).all()
    assert 0.0 < more.gain < 1.0


def test_the_command_says_what_is_next_and_when_to_stop(study, readings, capsys):
    arguments = ["next", str(study), "--readings", str(readings(6))]
    assert main([*arguments, "--wanted", "z_um=1e7"]) == 0
    out = capsys.readouterr().out
    assert "Geometry alone so far: every wanted accuracy would be reached" in out
    assert "Stop" not in out
    allowed = study.with_name("effects.study.toml")
    table = '\n[identify]\neffects = ["encoder_scale"]\n'
    allowed.write_text(study.read_text("utf-8") + table, encoding="utf-8")
    arguments[1] = str(allowed)
    assert main([*arguments, "--wanted", "z_um=1e7"]) == 0
    assert "Stop: every wanted accuracy is reached." in capsys.readouterr().out
    assert main([*arguments, "--wanted", "z_um=1e-6"]) == 0
    out = capsys.readouterr().out
    assert "more readings would not reach what is wanted" in out
    assert "6 readings taken" in out
    assert "z_mm = " in out
    assert "q1_mm = " in out
    assert "It should read length" in out


def test_readings_that_do_not_fit_end_no_session(study, readings, capsys):
    """Every second length is off by 0.02 mm: no accuracy is reached with those."""
    path = readings(21)
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    place = header.split(",").index("length_mm")
    for k in range(0, len(rows), 2):
        cells = rows[k].split(",")
        cells[place] = f"{float(cells[place]) + 0.02 * (-1) ** (k // 2):.6f}"
        rows[k] = ",".join(cells)
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    arguments = ["next", str(study), "--readings", str(path), "--wanted", "z_um=1e7"]
    assert main(arguments) == 1
    out = capsys.readouterr().out
    assert "the fit is bad" in out
    assert "Look for the cause before you go on" in out
    assert "Stop: every wanted accuracy" not in out


def test_the_file_is_followed(study, readings):
    path = readings(5)
    following = next_reading.Adviser(Study.load(study)).watch(path)
    assert next(following)[0].startswith("5 readings taken")
    path.write_text(readings(7).read_text(encoding="utf-8"), encoding="utf-8")
    assert next(following)[0].startswith("7 readings taken")
    path.write_text("nonsense\n1\n", encoding="utf-8")
    assert "column setup is missing" in next(following)[0]


def test_before_the_first_reading_the_plan_begins(study, tmp_path):
    """A sheet of poses whose cells are still empty."""
    sheet = tmp_path / "poses.csv"
    sheet.write_text(
        "setup,run,order,z_mm,psi_deg,theta_deg,length_mm\ncup,1,1,1146,15,20,\n",
        encoding="utf-8",
    )
    adviser, advice = _advised(study, sheet)
    lines = adviser.advice_sentences(advice)
    assert lines[0].startswith("0 readings taken")
    assert any(line.startswith("Next: ") for line in lines)


def _advised(
    study: Path, readings: Path
) -> tuple[next_reading.Adviser, next_reading.Advice]:
    adviser = next_reading.Adviser(Study.load(study))
    return adviser, adviser.advise(readings)


def test_the_plan_s_accuracy_can_be_wanted(study, readings):
    """Reached by the plan's own readings, and promised by no more than those."""
    adviser = next_reading.Adviser(Study.load(study), next_reading.AS_PLANNED)
    measurement = adviser.base.measurement
    before = adviser.advise_after(measurement, (), np.zeros(0))
    assert len(adviser.plan) == 21
    assert before.more is not None
    assert before.more <= 21
    chosen = adviser.base.resolved.candidates
    pool = Candidates.build(measurement, chosen, measurement.nominal, "tolerance")
    rows = pool.blocks[list(adviser.plan)].reshape(-1, pool.blocks.shape[2])
    covariance = np.linalg.inv(np.eye(rows.shape[1]) + rows.T @ rows)
    planned = np.einsum(
        "knm,mn->k", adviser.prior(measurement, pool).weights, covariance
    )
    np.testing.assert_allclose(before.limits, np.sqrt(planned), rtol=2e-6)
    assert not before.is_reached
    assert adviser.advise(readings(21)).is_reached


def test_the_plan_is_one_of_the_fewest(study):
    """One reading fewer, planned for the same goal, misses it."""
    adviser = next_reading.Adviser(Study.load(study))
    measurement = adviser.base.measurement
    chosen = adviser.base.resolved.candidates
    pool = Candidates.build(measurement, chosen, measurement.nominal, "tolerance")
    prior = adviser.prior(measurement, pool)
    every = prior.best_remaining(pool.blocks, 21)
    adviser.limits = adviser.accuracy(measurement, pool, every[:12])
    said = adviser.advise_after(measurement, (), np.zeros(0))
    more = said.more
    assert more is not None
    assert more >= 12  # these pass in every other machine, and 19 of 20 are to
    upper = np.quantile(said.outlook.drawn_rms, 0.95, axis=0)
    limits = adviser.limits * said.known / upper
    fewer = prior.best_remaining(pool.blocks, more - 1, limits)
    assert (adviser.accuracy(measurement, pool, fewer) > limits).any()
    adviser.limits = 0.9 * adviser.accuracy(measurement, pool, every)
    beyond = adviser.advise_after(measurement, (), np.zeros(0)).more
    assert beyond is not None
    assert beyond > 21


def test_what_is_missing_is_said(tmp_path):
    path = tmp_path / "bare.study.toml"
    path.write_text(sample.STUDY, encoding="utf-8")
    with pytest.raises(InputError, match="where accuracy counts"):
        next_reading.Adviser(Study.load(path))
    with pytest.raises(InputError, match="no candidates"):
        next_reading.Adviser(
            Study.load(shipped.study_path(Path("planar_step_calibration")))
        )


def test_sessions_are_compared_with_the_fixed_plan(study, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[3])
    benchmark = importlib.import_module("benchmarks.next_reading")
    setting = {"study": str(study)}
    row = benchmark.session(setting, 3)
    assert row == benchmark.session(setting, 3)
    assert row["fixed"] == 21
    assert row["readings"] <= 22
    ratios = [value for name, value in row.items() if name.startswith("ratio_")]
    assert 0.9 < max(ratios) < 1.05
    rows = [{**setting, **row}, {**setting, **row, "readings": row["readings"] + 2}]
    text = benchmark.table(rows)
    assert f"stops after {row['readings'] + 1:.2f} ± 1.96 on average" in text
    assert f"| worst component | {max(ratios):.3f} ± 0.000 |" in text


@pytest.mark.slow
def test_a_plan_for_the_goal_takes_fewer_readings_than_the_volume_s():
    """27 readings reach, on the nominal head, what 30 D-optimal ones do, throughout."""
    adviser = next_reading.Adviser(Study.load(shipped.study_path(Path("a3_ball_bar"))))
    resolved = adviser.base.resolved
    measurement = resolved.measurement
    chosen = select_design(resolved, np.random.default_rng(resolved.study.seed))
    pool = Candidates.build(
        measurement, resolved.candidates, measurement.nominal, "tolerance"
    )
    goal = adviser.accuracy(measurement, pool, chosen.choice.indices) * (1.0 + 1e-9)
    assert len(chosen.choice.indices) == 30
    prior = adviser.prior(measurement, pool)
    plan = prior.best_remaining(pool.blocks, 27, goal)
    reached = adviser.accuracy(measurement, pool, plan)
    assert (reached <= goal).all()


PLANAR = """
schema = 1
name = "small_planar"

[machine]
model = "planar_2dof"

[[setup]]
name = "tracker"
instrument = "pose_tracker_position"

[identify]
effects = {effects}

[design]
readings = 8

[[design.candidates]]
setup = "tracker"
y_mm = {{ from = -1000.0, to = 1000.0, count = 5 }}
z_mm = {{ from = 300.0, to = 1200.0, count = 4 }}

[prediction]
y_mm = [-900.0, 0.0, 900.0]
z_mm = [400.0, 1100.0]
"""


def adviser(folder: Path, effects: str, wanted: str = "") -> next_reading.Adviser:
    file = folder / "small.study.toml"
    file.write_text(PLANAR.format(effects=effects), encoding="utf-8")
    return next_reading.Adviser(Study.load(file), wanted)


def test_accuracy_is_that_of_a_dense_update(tmp_path):
    """Parameters and effects with their priors, updated by all readings at once."""
    with_effects = adviser(tmp_path, '["encoder_scale", "gravity"]')
    measurement = with_effects.base.measurement
    taken = [with_effects.base.resolved.candidates[0].take(np.arange(0, 20, 3))]
    y = measurement.readings(taken, measurement.nominal)
    effects = effects_at(with_effects.base, measurement, taken)
    numbers = effects.readings.take(slice(0, len(y)))
    free = measurement.free
    slopes = measurement.jacobian(taken, measurement.nominal) * measurement.tolerance
    rows = np.hstack([slopes[:, free], numbers.columns])
    noise = np.diag(measurement.noise(taken).sigma ** 2 + numbers.scatter**2)
    covariance = np.eye(rows.shape[1])
    gain = rows.T @ np.linalg.inv(rows @ rows.T + noise)
    covariance = covariance - gain @ rows
    raw = (
        with_effects.maps.raw * measurement.tolerance[: with_effects.maps.raw.shape[2]]
    )
    missing = np.zeros((*raw.shape[:2], len(measurement.names) - raw.shape[2]))
    of_parameters = np.concatenate([raw, missing], axis=2)[:, :, free]
    factors = np.concatenate([of_parameters, effects.tool], axis=2)
    variances = np.einsum("nkp,pq,nkq->nk", factors, covariance, factors).mean(axis=0)
    said = with_effects.advise_after(measurement, taken, y)
    assert said.known == pytest.approx(np.sqrt(variances + effects.others), rel=1e-6)
    assert (said.after < said.known).all()


def test_effects_leave_more_than_the_geometry_alone(tmp_path):
    rigid = adviser(tmp_path, '"none"')
    measurement = rigid.base.measurement
    taken = [rigid.base.resolved.candidates[0].take(np.arange(0, 20, 2))]
    y = measurement.readings(taken, measurement.nominal)
    alone = rigid.advise_after(measurement, taken, y)
    real = adviser(tmp_path, '"catalogue"').advise_after(measurement, taken, y)
    assert (real.known > alone.known).all()


def test_what_no_reading_reduces_is_never_reached(tmp_path):
    """Wanted is less than effects that these readings do not tell."""
    rigid = adviser(tmp_path, '"none"', "y_um=5,z_um=5")
    measurement = rigid.base.measurement
    every = [rigid.base.resolved.candidates[0]]
    y = measurement.readings(every, measurement.nominal)
    real = adviser(tmp_path, '"catalogue"', "y_um=5,z_um=5")
    assert not real.advise_after(measurement, every, y).is_reached


def test_residuals_of_expected_effects_are_no_bad_fit(tmp_path):
    """A scale of one drive: the fit without effects is bad, with them it is not."""
    files, expected = {}, {}
    for effects in ('"none"', '["encoder_scale"]'):
        one = adviser(tmp_path, effects)
        measurement = one.base.measurement
        taken = [one.base.resolved.candidates[0]]
        found = expected[effects] = effects_at(one.base, measurement, taken)
        if found is not None:
            change = 2.0 * found.readings.columns[: 3 * len(taken[0]), 0]
        files[effects] = (one, measurement, taken)
    chi2 = {}
    for effects, (one, measurement, taken) in files.items():
        y = measurement.readings(taken, measurement.nominal) + change
        estimate = next_reading._fit(one.base, measurement, taken, y, expected[effects])
        chi2[effects] = estimate.chi2 / estimate.dof
    assert chi2['["encoder_scale"]'] < 1.0
    assert chi2['"none"'] > 4.0 * chi2['["encoder_scale"]']
