"""A plan for accuracy and runs that find the cause of what it leaves, in one time."""

from pathlib import Path

import pytest
from gantry_forecast import PLAN
from sample import changed

from oed.result import ChosenRun, ChosenRuns, StudyResult
from pkm_studies import stages, study
from pkm_studies.base import InputError
from pkm_studies.resolve import resolve

STUDY = (
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


def planned(text: str, out: Path) -> StudyResult:
    return stages.plan_study(study.Study.parse(text, out / "both.study.toml"), out)


def new_runs(chosen: ChosenRuns) -> list[ChosenRun]:
    """The runs that are added to those of the plan."""
    return chosen.runs[chosen.retained :]


def added_seconds(chosen: ChosenRuns) -> float:
    return sum(run.seconds for run in new_runs(chosen))


def test_the_cause_takes_its_time_from_the_plan(tmp_path):
    result = planned(STUDY, tmp_path)
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
    result = planned(changed(STUDY, ("budget_min = 30.0\n", "")), tmp_path)
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
        planned(changed(STUDY, change), tmp_path)
    assert message in str(error.value)


def test_a_plan_that_the_study_does_not_request_is_not_retained(tmp_path):
    text = STUDY[: STUDY.index("[plan]")] + STUDY[STUDY.index("[[design.reference]]") :]
    with pytest.raises(InputError) as error:
        resolve(study.Study.parse(text, tmp_path / "both.study.toml"))
    assert 'gap.design.keep = "plan"' in str(error.value)
    assert "no such plan" in str(error.value)
