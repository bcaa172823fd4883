"""Plans of stages in studies, against all subsets of lines, after a session, and with a cause."""

import csv
import dataclasses
import itertools
import json
from pathlib import Path
from types import SimpleNamespace as Fake

import msgspec
import numpy as np
import pytest
import xarray
from gantry_forecast import PLAN
from plan_sample import HERE, STUDY, plan_of, planned
from sample import changed, table_lines

from oed.accuracy import ErrorMaps
from oed.identifiability import scaled
from oed.measurement import Measurement
from oed.mechanism import Kinematics
from oed.planning import Option
from oed.result import AlternativePlan, ChosenRun, ChosenRuns, PlanSection, StudyResult
from pkm_studies import stages, study
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.resolve import resolve
from pkm_studies.stages.plan.plan import (
    _largest_residual_um,
    loss_bound_text,
    more_accurate,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plan")


@pytest.fixture(scope="module")
def plan(folder: Path) -> PlanSection:
    return plan_of(planned(STUDY, folder))


@dataclasses.dataclass(frozen=True)
class Line:
    """One line of readings: its option, information about the machine, time in s."""

    option: str
    information: np.ndarray
    seconds: float


def every_line(options: tuple[Option, ...], m: Measurement) -> list[Line]:
    """The lines of all options."""
    lines = []
    for option in options:
        series = option.series[0]
        reading_seconds = m.setups[series.setup].instrument.cost.reading
        for run in dict.fromkeys(series.run):
            line = series.take(np.flatnonzero(series.run == run))
            h = scaled(m, [line], m.nominal, "tolerance")[:, :7]
            lines.append(Line(option.name, h.T @ h, len(line) * reading_seconds))
    return lines


def every_choice(budget: float) -> list[tuple[float, dict[str, float]]]:
    """Value and accuracy (um) of every choice of lines within the budget, s.

    They follow from the normal equations alone.
    """
    resolved = resolve(study.Study.parse(STUDY, HERE))
    m = resolved.measurement_with(["rm4", "rm5"])
    maps = ErrorMaps.of(m.kinematics, resolved.prediction.command, "home")
    slopes = maps.raw[:, :2] * m.tolerance[:7]
    before = np.sqrt(np.mean(np.sum(slopes**2, axis=2), axis=0))
    options = resolved.plan.options
    mounting = {
        o.name: m.setups[o.series[0].setup].instrument.cost.setup for o in options
    }
    lines = every_line(options, m)
    names = [f"{c.name}_um" for c in m.machine.components][:2]
    choices = []
    for size in range(1, len(lines) + 1):
        for chosen in itertools.combinations(lines, size):
            seconds = sum(line.seconds for line in chosen)
            seconds += sum(mounting[name] for name in {line.option for line in chosen})
            if seconds > budget:
                continue
            added = sum(line.information for line in chosen)
            covariance = np.linalg.inv(np.eye(7) + added)
            variance = np.einsum("nkp,pq,nkq->nk", slopes, covariance, slopes)
            rms = np.sqrt(np.mean(variance, axis=0))
            value = float(np.sqrt(np.mean((rms / before) ** 2)))
            choices.append((value, dict(zip(names, 1e6 * rms, strict=True))))
    return choices


def test_no_choice_of_lines_is_better_nor_below_the_bound(plan):
    best, accuracy = min(every_choice(110.0 * 60.0), key=lambda choice: choice[0])
    # linearisation residual and drawn machines aside
    assert plan.value == pytest.approx(best, rel=0.02)
    assert plan.bound is not None
    assert plan.bound <= best * (1 + 1e-9)
    assert plan.accuracy == pytest.approx(accuracy, rel=0.05)
    assert plan.cost <= 110.0
    assert plan.loss == pytest.approx(plan.value / plan.bound - 1.0)


def test_stages_follow_each_other_and_report_what_they_leave(plan):
    first, last = plan.stages
    assert first.begin_min == 0.0
    assert last.begin_min == first.end_min
    assert last.end_min == pytest.approx(plan.cost)
    assert plan.price == 20.0
    assert first.operator == "workshop"
    assert last.rank == 6
    combinations = " ".join(last.unidentified)
    assert (
        "z1 + z2" in combinations
        or "z2 + z1" in combinations
        or {"z1", "z2"} <= set(last.unidentified)
    )
    for name, before in first.parameters.items():
        assert last.parameters[name].sd <= before.sd * (1 + 1e-9)
    assert plan.stop


def test_sequences_stand_beside_the_plan_of_their_time(plan):
    alone = next(c for c in plan.compared if c.name == "RM 5")
    assert alone.rank == 6
    assert alone.sequence.names == ["RM 5"]
    for record in plan.compared:
        minutes, value = record.sequence.minutes, record.sequence.value
        least = min(v for v, _ in every_choice(minutes * 60.0 * (1 + 1e-9)))
        assert record.plan.value <= value * (1 + 1e-9)
        assert (
            record.plan.minutes <= minutes * (1 + 1e-6) or record.plan.minutes <= 110.0
        )
        assert record.bound <= record.plan.value * (1 + 1e-9)
        assert value >= least * 0.98


def csv_rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(table_lines(path.read_text(encoding="utf-8"))))


def test_files_hold_the_stages_and_their_poses(plan, folder):
    rows = csv_rows(folder / "plan.csv")
    assert [r["measurement"] for r in rows] == [s.measurement for s in plan.stages]
    assert float(rows[-1]["end_min"]) == pytest.approx(plan.cost, abs=0.06)
    text = (folder / "plan_poses.json").read_text(encoding="utf-8")
    stages = json.loads(text)["stages"]
    assert [len(s["poses"]) for s in stages] == [s.readings for s in plan.stages]
    pose = stages[0]["poses"][0]
    assert {"setup", "run", "order", "command", "reading", "joints"} <= set(pose)
    poses = csv_rows(folder / "poses.csv")
    order = [name for stage in plan.stages for name in stage.setups]
    setups = [pose["setup"] for pose in poses]
    assert setups == sorted(setups, key=order.index)
    assert {pose["dy_mm"] for pose in poses if pose["order"] != "1"} <= {""}


def test_an_old_plan_can_still_be_read():
    old = {"stages": [], "cost": 3.0, "alternatives": ["paper"]}
    assert msgspec.convert(old, PlanSection).alternatives == ["paper"]
    alternative = {
        "names": ["a"], "readings": [1], "minutes": 1.0, "value": 1.0, "accuracy": {},
    }  # fmt: skip
    newer = msgspec.convert(old | {"alternatives": [alternative]}, PlanSection)
    assert isinstance(newer.alternatives[0], AlternativePlan)


def test_a_target_accuracy_takes_the_least_time(plan, tmp_path):
    targets = {k: 1.5 * v for k, v in plan.accuracy.items()}
    table = ", ".join(f"{k} = {v}" for k, v in targets.items())
    text = changed(STUDY, ("stages = 2\n", f"stages = 2\nwanted = {{ {table} }}\n"))
    shorter = plan_of(planned(text, tmp_path))
    assert shorter.reached
    assert shorter.cost <= plan.cost
    assert all(shorter.accuracy[k] <= v * (1 + 1e-9) for k, v in targets.items())
    assert shorter.needs == []


def test_a_target_out_of_reach_is_reported_and_no_error(tmp_path, capsys):
    path = tmp_path / "far.study.toml"
    text = changed(STUDY, ("stages = 2\n", "stages = 2\nwanted = { y_um = 0.001 }\n"))
    path.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["plan", str(path), "--out", str(out)]) == 0
    plan = json.loads((out / "result.json").read_text(encoding="utf-8"))["plan"]
    assert not plan["reached"]
    assert plan["bound"] > 1.0
    assert "proven" in plan["needs"][0]
    assert "Out of reach" in " ".join(capsys.readouterr().out.split())


#: a session of one stage, simulated and identified, before the study's own plan
SESSION = """
[readings]
simulate = true
draw = true

[posterior]
"""
SEQUENCES = 'compare = [["RM 4", "RM 5"], ["RM 5"]]\n'


def run_session(text: str, posterior: str, out: Path) -> StudyResult:
    """The first stage in 25 min, measured and identified."""
    one_stage = changed(
        text, ("budget_min = 110.0", "budget_min = 25.0"), ("stages = 2", "stages = 1")
    )
    session = one_stage + SESSION + posterior
    return stages.run_study(study.Study.parse(session, HERE), out, report=False)


def test_further_stages_are_planned_after_a_session(tmp_path):
    """RM 4 read and identified: its measurement is done and its time spent.

    The machine is known as well as the session left it.
    """
    text = changed(STUDY, (SEQUENCES, ""))
    first = tmp_path / "first"
    before = run_session(text, "enabled = false\n", first)
    before_plan = plan_of(before)
    assert before.estimate is not None
    done = before_plan.stages[0]
    result = planned(text, tmp_path / "next", after=first)
    plan = plan_of(result)
    assert plan.budget_min == pytest.approx(110.0 - before_plan.cost)
    assert done.measurement not in [s.measurement for s in plan.stages]
    assert done.setups[0] in plan.after
    for name, accuracy in before_plan.start_accuracy.items():
        assert plan.start_accuracy[name] < accuracy
    nominal = {str(p["name"]): p["nominal"] for p in result.machine.parameters}
    assert nominal["beta1"] == pytest.approx(before.estimate.parameters["beta1"].value)


def posterior_draws(folder: Path, wanted: tuple[str, ...]) -> np.ndarray:
    """Draws (draws, n) of the parameters with these names."""
    path = folder / "posterior.nc"
    with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as data:
        names = [str(n) for n in data["parameter"].values]
        columns = [names.index(n) for n in wanted]
        return np.asarray(data["theta"].values).reshape(-1, len(names))[:, columns]


def test_a_plan_starts_from_the_draws_of_a_posterior(tmp_path):
    """RM 4 identified with draws: the next plan and its machines begin there."""
    text = changed(STUDY, (SEQUENCES, "virtual_machines = 60\n"))
    first = tmp_path / "first"
    without_machines = changed(text, ("virtual_machines = 60\n", ""))
    run_session(without_machines, "ess = 300\n", first)
    plan = plan_of(planned(text, tmp_path / "next", after=first))
    assert "draws of the posterior" in plan.after
    resolved = resolve(study.Study.parse(STUDY, HERE))
    machine_only = resolved.measurement_with(())
    draws = posterior_draws(first, machine_only.names)
    mean = draws.mean(axis=0)
    parameters = [
        dataclasses.replace(p, nominal=float(v))
        for p, v in zip(machine_only.machine.parameters, mean, strict=True)
    ]
    identified = machine_only.machine.with_parameters(parameters)
    command = resolved.prediction.command
    maps = ErrorMaps.of(Kinematics(identified), command, "home")
    slopes = np.moveaxis(maps.raw, 2, 1)[:, :, :2].reshape(len(command), 7, 2)
    spread = (draws - mean) @ slopes
    # a covariance of draws has one degree of freedom less than draws
    fewer = len(draws) / (len(draws) - 1)
    rms = np.sqrt(fewer * np.mean(spread**2, axis=(0, 1)))
    expected = dict(zip(("y_um", "z_um"), 1e6 * rms, strict=True))
    assert plan.start_accuracy == pytest.approx(expected, rel=1e-3)
    assert plan.virtual_machines == 60
    (only,) = plan.stages
    assert only.coverage is not None
    assert 0.88 < only.coverage < 0.995
    assert all(0.75 < v < 1.3 for v in only.realised.values()), only.realised


def test_how_much_better_is_a_share_or_a_factor():
    assert loss_bound_text(0.05) == "5.0 % better"
    assert loss_bound_text(10.44) == "11.4 times as accurate"
    assert more_accurate(1.19, 1.0) == "19 % more accurate"
    assert more_accurate(11.44, 1.0) == "11.4 times as accurate"


@pytest.mark.parametrize(("change", "field"), [
    (("budget_min = 110.0\n", ""), "plan.budget_min"),
    (("budget_min = 110.0\n", "budget_min = 1.0\n"), "plan.budget_min"),
    (("[prediction]\n", "[gap]\n"), ""),
    (('setup = "rm5"\ncounts', 'setup = "rm4"\ncounts'), "plan.measurement[2].setup"),
    (('setup = "rm5"\ncounts', 'setup = "rm6"\ncounts'), "plan.measurement[2].setup"),
    (('setup = "rm5"\ncounts = [1, 2, 3]', 'setup = "rm5"\ncounts = [9]'), "plan.measurement[2]"),
    (('["RM 5"]]', '["RM 6"]]'), "plan.compare[2][1]"),
    (("stages = 2\n", "stages = 2\nwanted = { w_um = 1.0 }\n"), "plan.wanted.w_um"),
    (('name = "RM 5"', 'name = "RM 4"'), "plan.measurement[2].name"),
])  # fmt: skip
def test_what_cannot_be_planned_is_refused_by_field(change, field, tmp_path):
    with pytest.raises(InputError) as caught:
        planned(changed(STUDY, change), tmp_path)
    assert field in str(caught.value)


def test_a_plan_needs_a_workspace(tmp_path):
    text = STUDY[: STUDY.index("[prediction]")]
    with pytest.raises(InputError, match="add a \\[prediction\\] table"):
        planned(text, tmp_path)


def test_what_linearisation_leaves_is_the_largest_of_the_lengths():
    """A set-up that reads a length and an angle, and one that reads angles alone."""

    def setup(*units: str) -> Fake:
        return Fake(instrument=Fake(channels=[Fake(unit=unit) for unit in units]))

    class Readings(list):
        setup: str

    setups = {"both": setup("m", "rad"), "angles": setup("rad")}

    def left(name: str, count: int, rms: list[float]) -> float | None:
        series = Readings(range(count))
        series.setup = name
        option = Fake(measurement=Fake(setups=setups))
        numbers = np.array(rms)
        stage = Fake(linearisation_rms=numbers, option=option, series=[series])
        return _largest_residual_um(stage)

    assert left("both", 2, [1e-6, 0.5, 3e-6, 0.2]) == pytest.approx(3.0)
    assert left("both", 1, [np.nan, 0.5]) is None
    assert left("angles", 2, [0.5, 0.2]) is None


BOTH = (
    PLAN.partition("[prediction]")[0].replace("gantry", "both")
    + """
[plan]
budget_min = 150.0
stages = 1

[[plan.measurement]]
name = "RM 5"
setup = "rm5"
counts = [2, 3]
whole_runs = true
y_mm = [0.0, -1500.0, -900.0, -300.0, 300.0, 900.0, 1500.0]
z_mm = [0.0, 750.0, 1500.0]
runs_by = "z"

[prediction]
reference = "home"
y_mm = { from = -1500.0, to = 1500.0, count = 5 }
z_mm = { from = 0.0, to = 1500.0, count = 5 }

[[design.reference]]
name = "lines"
setup = "rm5"
y_mm = [0.0, -1500.0, -900.0, -300.0, 300.0, 900.0, 1500.0]
z_mm = [0.0, 300.0, 750.0, 1200.0, 1500.0]
runs_by = "z"

[gap]
effects = ["gravity", "encoder_scale", "backlash"]

[gap.design]
find = ["gravity", "encoder_scale"]
keep = "plan"
candidates = ["lines"]
conditions = [{ payload_N = 0.0 }, { payload_N = 1000.0 }]
budget_min = 30.0
"""
)


def planned_both(text: str, out: Path) -> StudyResult:
    return stages.plan_study(study.Study.parse(text, out / "both.study.toml"), out)


def new_runs(chosen: ChosenRuns) -> list[ChosenRun]:
    """The runs that are added to those of the plan."""
    return chosen.runs[chosen.retained :]


def added_seconds(chosen: ChosenRuns) -> float:
    return sum(run.seconds for run in new_runs(chosen))


def test_the_cause_takes_its_time_from_the_plan(tmp_path):
    result = planned_both(BOTH, tmp_path)
    plan, chosen = result.plan, result.gap_before.chosen
    assert plan.budget_min == pytest.approx(120.0)
    assert plan.cost <= 120.0
    assert chosen.retained == 3  # the lines of the plan
    assert added_seconds(chosen) <= 1800.0 + 1e-6
    # without a second payload the plan's own lines say next to nothing of gravity
    assert chosen.before < 1.0
    assert chosen.separation > 4.0
    payloads = {run.condition["payload"] for run in new_runs(chosen)}
    assert payloads == {0.0, 1000.0}
    assert (tmp_path / "gap_poses.csv").is_file()


def test_the_cause_has_the_time_that_the_plan_does_not_take(tmp_path):
    result = planned_both(changed(BOTH, ("budget_min = 30.0\n", "")), tmp_path)
    plan, chosen = result.plan, result.gap_before.chosen
    assert plan.budget_min == pytest.approx(150.0)
    assert plan.cost + added_seconds(chosen) / 60.0 <= 150.0 + 1e-6
    assert len(chosen.runs) > chosen.retained


@pytest.mark.parametrize(("change", "message"), [
    (("budget_min = 30.0", "budget_min = 150.0"), "gap.design.budget_min = 150"),
    (("budget_min = 150.0", "budget_min = 100.0"), "30 min of it are for [gap.design]"),
])  # fmt: skip
def test_too_little_time_is_refused(tmp_path, change, message):
    with pytest.raises(InputError) as error:
        planned_both(changed(BOTH, change), tmp_path)
    assert message in str(error.value)


def test_a_plan_that_the_study_does_not_request_is_not_retained(tmp_path):
    text = BOTH[: BOTH.index("[plan]")] + BOTH[BOTH.index("[[design.reference]]") :]
    with pytest.raises(InputError) as error:
        resolve(study.Study.parse(text, tmp_path / "both.study.toml"))
    assert 'gap.design.keep = "plan"' in str(error.value)
    assert "no such plan" in str(error.value)
