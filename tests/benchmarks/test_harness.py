"""The benchmarks' harness: intervals, measures by hand, the campaign and its table."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from benchmarks.blind.world import draw
from benchmarks.harness import __main__ as command
from benchmarks.harness import cases, judge, statistics, stepwise, worlds
from benchmarks.harness.diagnosis import bench, prepare
from benchmarks.harness.worlds import Case
from oed.gap import GapProblem
from oed.gap.forms import library as library_of
from pkm_studies.commands import main

ROOT = Path(__file__).resolve().parents[2]


# -- intervals -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("hits", "count"), [(0, 73), (1, 75), (37, 40), (40, 40), (3, 4)]
)
def test_wilson_is_that_of_scipy(hits, count):
    interval = stats.binomtest(hits, count).proportion_ci(method="wilson")
    expected = pytest.approx((interval.low, interval.high), abs=1e-12)
    assert statistics.wilson(hits, count) == expected


def test_median_interval_is_of_order_statistics():
    values = [float(k) for k in range(1, 11)]
    assert statistics.median(values) == (5.5, 2.0, 9.0)
    assert statistics.median([1.0, 2.0, 3.0])[1:] == (-math.inf, math.inf)
    drawn = np.random.default_rng(1).exponential(size=(400, 25))
    inside = [
        low <= math.log(2) <= high for _, low, high in map(statistics.median, drawn)
    ]
    # P(8 <= B(25, 1/2) <= 17) = 0.957
    assert stats.binomtest(sum(inside), 400, 0.957).pvalue > 1e-3


def test_mean_interval_is_students():
    values = [0.2, 0.9, 1.0, 0.4]
    interval = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert statistics.mean(values)[1:] == pytest.approx(interval)
    assert statistics.half_width(values) == pytest.approx(np.ptp(interval) / 2)
    assert math.isnan(statistics.mean([])[0])


# -- measures --------------------------------------------------------------------------
CLEAR = {
    "effect": "backlash", "listed": True, "classes": ["backlash", "friction"],
    "outside": 7.0, "out_of_span": 3.0,
    "where": {"legs": [2], "runs": [3], "time_s": [[100.0, 200.0]]},
}  # fmt: skip
PUMP = {**CLEAR, "effect": "pump", "listed": False, "classes": None, "out_of_span": 8.0}
EXPECTED = {"C": 0.8, "gain": 50.0}


def label(kind: str, *effects: dict[str, Any], total: float = 10.0) -> dict[str, Any]:
    return {
        "machine": "a3", "kind": kind, "law": {"law": "white"},
        "effects": list(effects), "sqrt_lambda_total": total,
        "closure": {"within": EXPECTED, "whole": EXPECTED},
    }  # fmt: skip


def result(verdict: str, *names: str, where: str = "leg 2") -> dict[str, Any]:
    answer = {"effects": list(names), "probability": 0.93}
    return {
        "verdict": verdict, "answers": [answer], "set95": [answer],
        "where": [{"block": where}],
        "closure": [{"split": "within", "value": 0.4}],
    }  # fmt: skip


def measures(*scored: judge.Scored) -> dict[str, tuple[float, int]]:
    return {m.title: (m.value, m.count) for m in judge.rows(scored)}


@pytest.mark.parametrize("window", [[100.0, 200.0], [[0.0, 1.0], [100.0, 200.0]]])
def test_a_time_is_right_in_one_of_the_windows(window):
    for place, right in (("time 90-150", 1.0), ("time 300-400", 0.0)):
        case = label("single", {**CLEAR, "where": {"time_s": window}})
        said = result("effect", "friction", where=place)
        assert measures(judge.Scored(case, said))["right place"] == (right, 1)


def test_measures_count_by_hand():
    table = measures(
        judge.Scored(label("null"), result("none")),
        judge.Scored(label("null"), result("effect", "step")),
        judge.Scored(label("single", CLEAR), result("effect", "friction")),
        judge.Scored(
            label("single", CLEAR), result("effect", "gravity", where="run R07")
        ),
        judge.Scored(label("unknown", PUMP, total=6.0), result("none")),
    )
    assert table["false alarm"] == (0.5, 2)
    assert table["detection at sqrt(lambda) 6"] == (0.0, 1)
    assert table["detection at sqrt(lambda) 10 and more"] == (1.0, 2)
    assert table["right class"] == (0.5, 2)
    assert table["unknown flagged"] == (0.0, 1)
    assert table["closure over the oracle's, within"] == (pytest.approx(0.5), 2)
    assert table["right place"] == (0.5, 2)
    assert table["answers of probability 0.9 to 1 that are right"] == (0.4, 5)


def test_beside_a_listed_effect_another_needs_no_name():
    mixed = label("mixed", CLEAR, PUMP)
    assert judge.Scored(mixed, result("effect", "friction", "unknown")).is_right
    assert judge.Scored(mixed, result("effect", "backlash")).is_right
    assert not judge.Scored(mixed, result("unknown", "unknown")).is_right
    pair = label("pair", CLEAR, {**CLEAR, "effect": "step", "classes": ["step"]})
    assert not judge.Scored(pair, result("effect", "backlash")).is_right
    assert judge.Scored(pair, result("effect", "step", "friction")).is_right


def test_a_label_without_closures_and_runs_asks_for_none():
    place = {**CLEAR, "where": {"legs": [2]}}
    bare = {**label("single", place), "closure": {}}
    table = measures(judge.Scored(bare, result("effect", "backlash", where="run R07")))
    assert table["closure over the oracle's, within"][1] == 0
    assert table["right place"][1] == 0


# -- campaign and table ----------------------------------------------------------------
def test_the_campaign_keeps_labels_and_its_table_is_printed(
    tmp_path, monkeypatch, capsys
):
    """On a shipped campaign, with a world and diagnoses by hand; a failure stops nothing."""
    labels = [label("null"), label("single", CLEAR)]
    world = SimpleNamespace(
        draw=lambda setting, number, folder: Case(
            f"case {number}", folder, folder, labels[number], true_law=str
        )
    )

    def diagnose(study: Path, readings: Path, stream: Any, law: Any) -> dict[str, Any]:
        drawn.append(law)
        if len(drawn) == 3:
            raise ArithmeticError("no luck")
        return result("none") if len(drawn) == 1 else result("effect", "backlash")

    drawn: list[Any] = []
    monkeypatch.setattr(worlds, "load", lambda name: world)
    monkeypatch.setattr(cases, "diagnose", diagnose)
    text = (ROOT / "benchmarks" / "second.campaign.toml").read_text("utf-8")
    text = text.replace('["a3", "planar", "delta", "hexapod"]', '["a3"]')
    (tmp_path / "cases.py").write_text(
        "from benchmarks.harness.cases import diagnosis, verdicts\n", "utf-8"
    )
    file, out = tmp_path / "second.campaign.toml", tmp_path / "second"
    file.write_text(text.replace("harness/cases.py:", "cases.py:"), "utf-8")
    options = ["second", "--campaign", str(out)]
    assert command.main(options) == 2
    assert "second.campaign.toml` first" in capsys.readouterr().err
    arguments = ["campaign", str(file), "--out", str(out), "--workers", "1"]
    assert main([*arguments, "--seeds", "2"]) == 0
    assert drawn == [None, None, str, str]
    capsys.readouterr()
    assert command.main(options) == 0
    table = capsys.readouterr().out
    assert table.startswith("2 cases")
    assert "| measure | estimated law | true law |" in table
    assert "| right class | 1.00" in table
    assert "| backlash | 1 | 1 | 1 | - |" in table
    assert json.loads(next((out / "cases").glob("*.json")).read_text())["label"]


# -- baseline --------------------------------------------------------------------------
@pytest.fixture(scope="module")
def a3_case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A case of the A3's full plan, whose readings give the slopes."""
    folder = tmp_path_factory.mktemp("case")
    setting = {"set": "dev", "set_seed": 3}
    numbers = (k for k in range(400) if _is_plain_a3(k))
    return draw(setting, next(numbers), folder)


def _is_plain_a3(number: int) -> bool:
    from benchmarks.blind.generator.cases import role

    part = role(3, "dev", number)
    return (part.kind, part.machine, part.plan) == ("null", "a3", "full")


def clean(problem: GapProblem, seed: int) -> GapProblem:
    """White noise in place of the residuals, and parameters within their tolerances."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=problem.slopes.shape[1])
    return problem.with_residual(rng.normal(size=len(problem)) + problem.slopes @ theta)


@pytest.mark.slow
def test_stepwise_takes_the_form_of_least_bic(a3_case):
    """Against explicit least squares with a row a parameter for its tolerance."""
    problem, _ = prepare(a3_case.study, a3_case.readings)
    tried = ("servo_lag", "gravity", "bar_length")
    effects = [e for e in bench(a3_case.study)[1] if e.name in tried]
    library = library_of.build(problem, effects)
    lag = next(
        a for a in library.atoms if a.effect == "servo_lag" and len(a.columns) > 1
    )
    quiet = clean(problem, 1)
    columns = library.columns.all()
    change = columns[:, lag.columns] @ np.full(len(lag.columns), 0.5)
    acting = quiet.with_residual(quiet.residual + change)
    assert stepwise.stepwise(quiet, library) == []

    def bic(chosen: Any) -> float:
        n, m = problem.slopes.shape
        nothing = np.zeros((m, len(chosen)))
        upper = [problem.slopes, columns[:, chosen]]
        design = np.block([upper, [np.eye(m), nothing]])
        target = np.concatenate([acting.residual, np.zeros(m)])
        scaled = design / np.linalg.norm(design, axis=0)
        fit = np.linalg.lstsq(scaled, target, rcond=1e-12)[0]
        residual = target - scaled @ fit
        return float(n * math.log(residual @ residual) + len(chosen) * math.log(n))

    bics = {
        k: bic(a.columns) + len(a.constants) * math.log(len(problem))
        for k, a in enumerate(library.atoms)
    }
    best = min(bics, key=lambda k: bics[k])
    assert bics[best] < bic([])
    first = stepwise.stepwise(acting, library)[0]
    assert first == library.atoms[best].effect == "servo_lag"
