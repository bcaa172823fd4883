"""Plans of stages in studies: against all subsets of lines, with what was learned
before, and what is refused.
"""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from sample import changed

from oed import information, predict
from oed.kinematics import Kinematics
from oed.result import AlternativePlan, StudyResult
from pkm_studies import cli, pipeline, study
from pkm_studies.errors import InputError
from pkm_studies.resolve.resolved import resolve

LINES = """\
[[plan.measurement]]
name = "RM {n}"
setup = "rm{n}"
counts = [1, 2, 3]
whole_runs = true
operator = "workshop"
price = 10.0
y_mm = {y}
z_mm = {z}
runs_by = "{by}"
"""
STUDY = """\
schema = 1
name = "lines"

[machine]
model = "planar_2dof"

[[setup]]
name = "rm4"
instrument = "rm4"

[[setup]]
name = "rm5"
instrument = "rm5"

[plan]
budget_min = 110.0
stages = 2
compare = [["RM 4", "RM 5"], ["RM 5"]]

"""
STUDY += LINES.format(
    n=4, y="[-1500.0, 0.0, 1500.0]", z="[0.0, 500.0, 1000.0, 1500.0]", by="y"
)
STUDY += LINES.format(
    n=5, y="[0.0, -1500.0, -750.0, 750.0, 1500.0]", z="[0.0, 750.0, 1500.0]", by="z"
)
STUDY += """
[prediction]
reference = "home"
y_mm = [-1500.0, -500.0, 500.0, 1500.0]
z_mm = [0.0, 750.0, 1500.0]

[report]
html = false
pdf = false
"""
HERE = Path("lines.study.toml")


def made(text: str, out: Path, after: Path | None = None) -> StudyResult:
    return pipeline.plan_stages(study.parse(text, HERE), out, after=after)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("plan")


@pytest.fixture(scope="module")
def planned(folder: Path) -> StudyResult:
    return made(STUDY, folder)


def everything(budget: float) -> list[tuple[float, dict[str, float]]]:
    """Value and accuracy (um) of every choice of lines within the budget, s: by the
    normal equations alone.
    """
    found = resolve(study.parse(STUDY, HERE))
    assert found.plan is not None
    assert found.prediction_commands is not None
    m = found.measurement_with(["rm4", "rm5"])
    maps = predict.error_maps(m.kinematics, found.prediction_commands, "home")
    slopes = maps.raw[:, :2] * m.tolerance[:7]
    before = np.sqrt(np.mean(np.sum(slopes**2, axis=2), axis=0))
    lines = []
    for o in found.plan.options:
        for run in dict.fromkeys(o.series[0].run):
            s = o.series[0].take(np.flatnonzero(o.series[0].run == run))
            h = information.scaled(m, [s], m.nominal, "tolerance")[:, :7]
            lines.append(
                (o.name, h.T @ h, len(s) * m.setups[s.setup].instrument.cost.reading)
            )
    mounting = {
        o.name: m.setups[o.series[0].setup].instrument.cost.setup
        for o in found.plan.options
    }
    told = []
    for size in range(1, len(lines) + 1):
        for some in itertools.combinations(lines, size):
            if (
                sum(x[2] for x in some) + sum(mounting[n] for n in {x[0] for x in some})
                > budget
            ):
                continue
            left = np.linalg.inv(np.eye(7) + sum(x[1] for x in some))
            rms = np.sqrt(
                np.mean(np.einsum("nkp,pq,nkq->nk", slopes, left, slopes), axis=0)
            )
            names = [c.name for c in m.machine.components][:2]
            accuracy = dict(zip((f"{n}_um" for n in names), 1e6 * rms, strict=True))
            told.append((float(np.sqrt(np.mean((rms / before) ** 2))), accuracy))
    return told


def test_no_choice_of_lines_is_better_nor_below_the_bound(planned: StudyResult) -> None:
    plan = planned.plan
    assert plan is not None
    best, accuracy = min(everything(110.0 * 60.0), key=lambda t: t[0])
    assert plan.value == pytest.approx(
        best, rel=0.02
    )  # cut-off and drawn machines aside
    assert plan.bound is not None
    assert plan.bound <= best * (1 + 1e-9)
    assert plan.accuracy == pytest.approx(accuracy, rel=0.05)
    assert plan.cost <= 110.0
    assert plan.loss == pytest.approx(plan.value / plan.bound - 1.0)


def test_stages_follow_each_other_and_say_what_they_leave(planned: StudyResult) -> None:
    assert planned.plan is not None
    first, last = planned.plan.stages
    assert (first.begin_min, last.begin_min, last.end_min) == (
        0.0,
        first.end_min,
        pytest.approx(planned.plan.cost),
    )
    assert planned.plan.price == 20.0
    assert first.operator == "workshop"
    assert last.rank == 6
    assert (
        "z1 + z2" in " ".join(last.unidentified)
        or {"z1", "z2"} <= set(last.unidentified)
        or "z2 + z1" in " ".join(last.unidentified)
    )
    assert all(
        last.parameters[n].sd <= sd.sd * (1 + 1e-9)
        for n, sd in first.parameters.items()
    )
    assert planned.plan.stop


def test_sequences_stand_beside_the_plan_of_their_time(planned: StudyResult) -> None:
    assert planned.plan is not None
    alone = next(c for c in planned.plan.compared if c.name == "RM 5")
    assert alone.rank == 6
    assert alone.sequence.names == ["RM 5"]
    for c in planned.plan.compared:
        least = min(v for v, _ in everything(c.sequence.minutes * 60.0 * (1 + 1e-9)))
        assert c.plan.value <= c.sequence.value * (1 + 1e-9)
        assert (
            c.plan.minutes <= c.sequence.minutes * (1 + 1e-6) or c.plan.minutes <= 110.0
        )
        assert c.bound <= c.plan.value * (1 + 1e-9)
        assert c.sequence.value >= least * 0.98


def test_files_hold_the_stages_and_their_poses(
    planned: StudyResult, folder: Path
) -> None:
    assert planned.plan is not None
    rows = list(
        csv.DictReader((folder / "plan.csv").read_text(encoding="utf-8").splitlines())
    )
    assert [r["measurement"] for r in rows] == [
        s.measurement for s in planned.plan.stages
    ]
    assert float(rows[-1]["end_min"]) == pytest.approx(planned.plan.cost, abs=0.06)
    stages = json.loads((folder / "plan_poses.json").read_text(encoding="utf-8"))[
        "stages"
    ]
    assert [len(s["poses"]) for s in stages] == [
        s.readings for s in planned.plan.stages
    ]
    pose = stages[0]["poses"][0]
    assert {"setup", "run", "order", "command", "reading", "joints"} <= set(pose)
    poses = list(
        csv.DictReader((folder / "poses.csv").read_text(encoding="utf-8").splitlines())
    )
    assert [r["setup"] for r in poses] == sorted(
        (r["setup"] for r in poses), key=lambda n: planned_order(planned, n)
    )
    assert {r["dy_mm"] for r in poses if r["order"] != "1"} <= {""}


def planned_order(planned: StudyResult, setup: str) -> int:
    assert planned.plan is not None
    return [n for s in planned.plan.stages for n in s.setups].index(setup)


def test_an_old_plan_can_still_be_read() -> None:
    import msgspec

    from oed import result

    old = {"stages": [], "cost": 3.0, "alternatives": ["paper"]}
    assert msgspec.convert(old, result.PlanSection).alternatives == ["paper"]
    way = msgspec.convert(old | {"alternatives": [{"names": ["a"], "readings": [1], "minutes": 1.0, "value": 1.0,
                                                   "accuracy": {}}]}, result.PlanSection)  # fmt: skip
    assert isinstance(way.alternatives[0], AlternativePlan)


def test_a_wanted_accuracy_takes_the_least_time(
    planned: StudyResult, tmp_path: Path
) -> None:
    assert planned.plan is not None
    reached = {k: 1.5 * v for k, v in planned.plan.accuracy.items()}
    told = ", ".join(f"{k} = {v}" for k, v in reached.items())
    plan = made(
        changed(STUDY, ("stages = 2\n", f"stages = 2\nwanted = {{ {told} }}\n")),
        tmp_path,
    ).plan
    assert plan is not None
    assert plan.reached
    assert plan.cost <= planned.plan.cost
    assert all(plan.accuracy[k] <= v * (1 + 1e-9) for k, v in reached.items())
    assert plan.needs == []


def test_a_goal_out_of_reach_is_told_and_no_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "far.study.toml"
    path.write_text(
        changed(STUDY, ("stages = 2\n", "stages = 2\nwanted = { y_um = 0.001 }\n")),
        encoding="utf-8",
    )
    assert cli.main(["plan", str(path), "--out", str(tmp_path / "out")]) == cli.DONE
    plan = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))[
        "plan"
    ]
    assert not plan["reached"]
    assert plan["bound"] > 1.0
    assert "proven" in plan["needs"][0]
    assert "Out of reach" in " ".join(capsys.readouterr().out.split())


def test_the_rest_is_planned_with_what_was_learned(tmp_path: Path) -> None:
    """RM 4 read and identified: its measurement is done, its time spent, the machine
    known as well as it left it.
    """
    text = changed(STUDY, ('compare = [["RM 4", "RM 5"], ["RM 5"]]\n', ""))
    first = tmp_path / "first"
    short = changed(
        text, ("budget_min = 110.0", "budget_min = 25.0"), ("stages = 2", "stages = 1")
    )
    short += (
        "\n[readings]\nsimulate = true\ndraw = true\n\n[posterior]\nenabled = false\n"
    )
    before = pipeline.run(study.parse(short, HERE), first, report=False)
    assert before.plan is not None
    assert before.estimate is not None
    done = before.plan.stages[0]
    rest = made(text, tmp_path / "rest", after=first)
    assert rest.plan is not None
    assert rest.plan.budget_min == pytest.approx(110.0 - before.plan.cost)
    assert done.measurement not in [s.measurement for s in rest.plan.stages]
    assert done.setups[0] in rest.plan.after
    assert all(
        rest.plan.start_accuracy[k] < v for k, v in before.plan.start_accuracy.items()
    )
    nominal = {str(p["name"]): p["nominal"] for p in rest.machine.parameters}
    assert nominal["beta1"] == pytest.approx(before.estimate.parameters["beta1"].value)


def test_draws_of_a_posterior_tell_what_was_learned_and_machines_are_drawn_from_it(
    tmp_path: Path,
) -> None:
    """RM 4 identified with draws: the plan of the rest begins where they are, and
    virtual machines with it.
    """
    text = changed(
        STUDY, ('compare = [["RM 4", "RM 5"], ["RM 5"]]\n', "virtual_machines = 60\n")
    )
    first = tmp_path / "first"
    short = changed(
        text, ("budget_min = 110.0", "budget_min = 25.0"), ("stages = 2", "stages = 1")
    )
    short = changed(short, ("virtual_machines = 60\n", ""))
    short += "\n[readings]\nsimulate = true\ndraw = true\n\n[posterior]\ness = 300\n"
    pipeline.run(study.parse(short, HERE), first, report=False)
    rest = made(text, tmp_path / "rest", after=first).plan
    assert rest is not None
    assert "draws of the posterior" in rest.after
    found = resolve(study.parse(STUDY, HERE))
    base = found.measurement_with(())
    with xarray.open_dataset(
        first / "posterior.nc", group="posterior", engine="h5netcdf"
    ) as data:
        names = [str(n) for n in data["parameter"].values]
        columns = [names.index(n) for n in base.names]
        draws = np.asarray(data["theta"].values).reshape(-1, len(names))[:, columns]
    believed = base.machine.with_parameters(
        [
            dataclasses.replace(p, nominal=float(v))
            for p, v in zip(base.machine.parameters, draws.mean(0), strict=True)
        ]
    )
    assert found.prediction_commands is not None
    maps = predict.error_maps(Kinematics(believed), found.prediction_commands, "home")
    spread = (draws - draws.mean(axis=0)) @ np.moveaxis(maps.raw, 2, 1)[
        :, :, :2
    ].reshape(len(maps.command), 7, 2)
    rms = np.sqrt(np.mean(spread**2, axis=(0, 1)))
    assert rest.start_accuracy == pytest.approx(
        dict(zip(("y_um", "z_um"), 1e6 * rms, strict=True)), rel=1e-3
    )
    assert rest.virtual_machines == 60
    (only,) = rest.stages
    assert only.coverage is not None
    assert 0.88 < only.coverage < 0.995
    assert all(0.75 < v < 1.3 for v in only.realised.values()), only.realised


def test_how_much_better_is_a_share_or_a_factor() -> None:
    from pkm_studies.stages.plan import words as plan_words

    assert plan_words.no_more(0.05) == "5.0 % better"
    assert plan_words.no_more(10.44) == "11.4 times as accurate"
    assert plan_words.better(1.19, 1.0) == "19 % more accurate"
    assert plan_words.better(11.44, 1.0) == "11.4 times as accurate"


@pytest.mark.slow
def test_in_the_time_of_the_papers_circles_a_gauge_and_bars_are_three_times_as_accurate(
    tmp_path: Path,
) -> None:
    """The plan of 22 minutes itself on 200 virtual machines, and the paper's circles
    beside it.
    """
    path = Path(__file__).parents[1] / "studies" / "a3_budget.study.toml"
    text = changed(
        path.read_text(encoding="utf-8"), ("budget_min = 109.0", "budget_min = 22.0")
    )
    text = text[: text.index("[expect]")]
    plan = pipeline.plan_stages(study.parse(text, path), tmp_path).plan
    assert plan is not None
    (paper,) = plan.compared
    assert plan.cost <= paper.sequence.minutes * (1 + 1e-9)
    gain = {k: v / plan.accuracy[k] for k, v in paper.sequence.accuracy.items()}
    assert gain["z_um"] >= 3.0
    assert min(gain.values()) >= 1.5
    for stage in plan.stages:
        assert all(0.8 <= v <= 1.25 for v in stage.realised.values()), (
            stage.measurement,
            stage.realised,
        )
        assert stage.coverage is not None
        assert 0.93 <= stage.coverage <= 0.97


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (("budget_min = 110.0\n", ""), "plan.budget_min"),
        (("budget_min = 110.0\n", "budget_min = 1.0\n"), "plan.budget_min"),
        (("[prediction]\n", "[gap]\n"), ""),
        (
            ('setup = "rm5"\ncounts', 'setup = "rm4"\ncounts'),
            "plan.measurement[2].setup",
        ),
        (
            ('setup = "rm5"\ncounts', 'setup = "rm6"\ncounts'),
            "plan.measurement[2].setup",
        ),
        (
            ('setup = "rm5"\ncounts = [1, 2, 3]', 'setup = "rm5"\ncounts = [9]'),
            "plan.measurement[2]",
        ),
        (('["RM 5"]]', '["RM 6"]]'), "plan.compare[2][1]"),
        (("stages = 2\n", "stages = 2\nwanted = { w_um = 1.0 }\n"), "plan.wanted.w_um"),
        (('name = "RM 5"', 'name = "RM 4"'), "plan.measurement[2].name"),
    ],
)
def test_what_cannot_be_planned_is_refused_by_field(
    change: tuple[str, str], field: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        made(changed(STUDY, change), tmp_path)
    assert field in str(caught.value)


def test_a_plan_needs_a_workspace(tmp_path: Path) -> None:
    text = STUDY[: STUDY.index("[prediction]")]
    with pytest.raises(InputError, match="add a \\[prediction\\] table"):
        made(text, tmp_path)
