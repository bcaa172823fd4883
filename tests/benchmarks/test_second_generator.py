"""The benchmark on the second generator: its cases, and its measures by hand."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.second import __main__ as command
from benchmarks.second import adapter, cases, run, score
from oed.noise import Laws, NoiseLaw
from pkm_studies.commands import main

ROOT = Path(__file__).resolve().parents[2]

CLEAR = {
    "effect": "backlash",
    "classes": ["backlash", "friction"],
    "outside": 7.0,
    "out_of_span": 3.0,
    "where": {"legs": [2], "runs": [3], "time_s": [100.0, 200.0]},
}
EXPECTED = {"C": 0.8, "gain": 50.0}


def label(kind: str, *effects: dict, total: float = 10.0) -> dict:
    return {
        "machine": "a3",
        "kind": kind,
        "law": {"law": "white"},
        "effects": list(effects),
        "sqrt_lambda_total": total,
        "closure": {"within": EXPECTED, "whole": EXPECTED},
    }


def result(verdict: str, *names: str, where: str = "leg 2") -> dict:
    answer = {"effects": list(names), "probability": 0.93}
    return {
        "verdict": verdict,
        "answers": [answer],
        "set95": [answer],
        "where": [{"block": where}],
        "closure": [{"split": "within", "value": 0.4}],
    }


def values(*scored: score.Scored) -> dict[str, tuple[float, int]]:
    return {r.measure: (r.value, r.count) for r in score.rows(scored)}


def test_measures_count_by_hand() -> None:
    unknown = {**CLEAR, "effect": "rust", "classes": None, "out_of_span": 8.0}
    table = values(
        score.Scored(label("null"), result("none")),
        score.Scored(label("null"), result("effect", "step")),
        score.Scored(label("single", CLEAR), result("effect", "friction")),
        score.Scored(
            label("single", CLEAR), result("effect", "gravity", where="run R07")
        ),
        score.Scored(label("unknown", unknown, total=6.0), result("none")),
    )
    assert table["false alarm"] == (0.5, 2)
    assert table["detection at sqrt(lambda) 6"] == (0.0, 1)
    assert table["detection at sqrt(lambda) 10 and more"] == (1.0, 2)
    assert table["right class"] == (0.5, 2)
    assert table["mean probability of the true class"] == (pytest.approx(0.465), 2)
    assert table["unknown flagged"] == (0.0, 1)
    assert table["closure over the oracle's, within"] == (pytest.approx(0.5), 2)
    assert table["right place"] == (0.5, 2)
    assert table["answers of probability 0.9 to 1 that are right"] == (0.4, 5)
    assert table["no gap at 0.9 and more is right"] == (0.5, 2)


def test_the_campaign_diagnoses_each_case_under_both_laws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the shipped campaign, with diagnoses by hand; a failure stops nothing."""
    places = tmp_path / "set" / "cases"
    (places / "a3").mkdir(parents=True)
    labels = {"case_001": label("null"), "case_002": label("single", CLEAR)}
    (places / "a3.labels.json").write_text(json.dumps(labels), "utf-8")
    for name in labels:
        (places / "a3" / f"{name}.json").write_text("{}", "utf-8")

    def diagnose(case: cases.Case, law: str) -> dict:
        if (case.name, law) == ("case_001", "true"):
            raise ArithmeticError("no luck")
        single = result("effect", "backlash")
        return result("none") if case.name == "case_001" else single

    monkeypatch.setattr(run, "_record", diagnose)
    text = (ROOT / "benchmarks" / "second.campaign.toml").read_text("utf-8")
    text = text.replace('"out/second/set"', json.dumps(str(tmp_path / "set")))
    text = text.replace('["a3", "planar", "delta", "hexapod"]', '["a3"]')
    file, out = tmp_path / "second.campaign.toml", tmp_path / "out"
    functions = "from benchmarks.second.run import diagnosis, verdicts\n"
    (tmp_path / "run.py").write_text(functions, "utf-8")
    file.write_text(text.replace("second/run.py:", "run.py:"), "utf-8")
    assert command.main(["table", "--campaign", str(out)]) == 2
    assert "second.campaign.toml` first" in capsys.readouterr().err
    arguments = ["campaign", str(file), "--out", str(out), "--workers", "1"]
    assert main([*arguments, "--seeds", "2"]) == 0
    capsys.readouterr()
    assert command.main(["table", "--campaign", str(out)]) == 0
    table = capsys.readouterr().out
    assert table.startswith("2 cases")
    assert "| right class | 1.00" in table
    failed = table.split("| no gap at 0.9 and more is right |")[1]
    assert failed.count("-") == 1  # the failed one gives no answer
    assert main([*arguments, "--seeds", "3"]) == 2
    assert "the set has 2 cases of a3: give" in capsys.readouterr().err


def test_without_the_generator_the_command_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--out", str(tmp_path), "--generator", str(tmp_path / "nowhere")]
    assert command.main(["generate", *options]) == 0
    assert "the second generator is not there" in capsys.readouterr().out


@pytest.mark.skipif(
    not cases.GENERATOR.is_dir(), reason="the second generator is not there"
)
@pytest.mark.parametrize(
    "machine",
    [
        m if m in ("a3", "delta") else pytest.param(m, marks=pytest.mark.slow)
        for m in adapter.MACHINES
    ],
)
def test_a_case_becomes_readings_that_the_nominal_machine_nearly_has(
    tmp_path: Path, machine: str
) -> None:
    cases.generate(tmp_path, 11, 1, [machine], cases.GENERATOR)
    (name,) = cases.names(tmp_path, machine)
    case = cases.Case(tmp_path, machine, name)
    problem, effects = cases.prepare(case)
    stated = json.loads(case.stem.with_suffix(".json").read_text(encoding="utf-8"))
    assert len(problem.names) >= len(stated["tolerances"])
    assert {"screw_cyclic", "encoder_subdivision"} <= {e.name for e in effects}
    # the fit leaves a few times the noise, whatever acts: geometry and units agree
    absorbed, *_ = np.linalg.lstsq(problem.slopes, problem.residual, rcond=None)
    rest = problem.residual - problem.slopes @ absorbed
    assert math.sqrt(np.mean(rest**2)) < 5.0


def test_the_true_law_has_the_labels_sizes() -> None:
    """In units of what single readings scatter by, which is the stated noise."""
    one = np.ones(1)
    stated = Laws(
        scale=np.ones((1, 1)),
        carried=0.0 * one,
        reach=one,
        level=0.0 * one,
        seat=0.0 * one,
    )
    problem = SimpleNamespace(stated_law=NoiseLaw(stated))
    label = {"repeat_over_sigma": 0.8, "rho": 0.9, "ar_over_sigma": 0.5}
    law = run.true_law(problem, label).law
    scale, carried = law.scale[0, 0], law.carried[0]
    assert scale * math.sqrt(1.0 - carried) == pytest.approx(1.0)
    assert scale * math.sqrt(carried) == pytest.approx(0.5)
    assert scale * law.level[0] == pytest.approx(0.8)
    assert math.exp(-1.0 / law.reach[0]) == pytest.approx(0.9)
