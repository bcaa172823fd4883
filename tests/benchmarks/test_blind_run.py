"""The blind benchmark's campaign: labels stay shut, cases keep their numbers."""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pkm_studies.commands import main

ROOT = Path(__file__).resolve().parents[2]


BLIND = ROOT / "benchmarks" / "blind"


NAMES = (
    "case",
    "entries",
    "harmonic",
    "known_noise",
    "listing",
    "loading",
    "oracle",
    "results",
    "run",
    "stepwise",
    "generator.severity",
    "generator.write",
)


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The benchmark's modules."""
    return blind_modules(*NAMES)


def test_the_runner_cannot_know_labels():
    """Neither imports nor names what only the scorer may open."""
    for name in ("case", "run", "loading", "harmonic", "stepwise"):
        tree = ast.parse((BLIND / f"{name}.py").read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                "benchmarks"
            ):
                modules = {
                    node.module,
                    *(f"{node.module}.{a.name}" for a in node.names),
                }
                shut = (
                    "generator",
                    "oracle",
                    "entries",
                    "known_noise",
                    "listing",
                    "checks",
                    "diagnosis_measures",
                    "measures",
                    "paired",
                    "places",
                    "results",
                    "selection",
                    "score",
                    "judge",
                )
                assert not any(
                    m.startswith(f"benchmarks.blind.{s}") for m in modules for s in shut
                )
        docs = {
            ast.get_docstring(n, clean=False)
            for n in ast.walk(tree)
            if isinstance(n, ast.Module | ast.FunctionDef | ast.ClassDef)
        }
        words = [
            n.value
            for n in ast.walk(tree)
            if isinstance(n, ast.Constant) and isinstance(n.value, str)
        ]
        assert not [
            w for w in words if w not in docs and ("labels" in w or "truth" in w)
        ]


def diagnosed(blind, problem):
    """A diagnosis without a search: no gap."""

    from kernel.laws import noise_law
    from oed.gap import Diagnosis
    from oed.result import AnswerRecord, ClosureRecord, PlaceRecord

    answers = (
        AnswerRecord((), 0.9),
        AnswerRecord(("step",), 0.1, (("step", "mount_drift"),)),
    )
    nothing = np.zeros(len(problem))
    fields = {f.name: () for f in dataclasses.fields(Diagnosis)} | {
        "problem": problem, "verdict": "none", "answers": answers, "set95": answers, "marginal": {"step": 0.1},
        "law": noise_law(variance=2.0),
        "explained": nothing, "unexplained": nothing, "before": nothing, "after": nothing,
        "where": (PlaceRecord("leg 1", 0.5, 0.1),), "not_testable": {},
        "closure": (ClosureRecord("whole", math.nan, -math.inf, math.inf, 0.5, 1.0, 1.1, 1.0, 10),),
    }  # fmt: skip
    return Diagnosis(**fields)


@pytest.fixture
def sets(blind_case_set, tmp_path) -> Path:
    """A folder as the campaign has it, with lists of some of its cases."""
    folder = tmp_path / "sets"
    for name in ("set", "pairs"):
        shutil.copytree(blind_case_set, folder / name)
    names = (blind_case_set / "order.txt").read_text(encoding="utf-8").split()
    lines = [{"id": names[1], "without": "step"}, {"id": names[2]}]
    for name, line in zip(("withheld", "separated"), lines, strict=True):
        (folder / f"{name}.jsonl").write_text(json.dumps(line) + "\n", "utf-8")
    return folder


def without_labels(folder: Path) -> None:
    for name in ("set", "pairs"):
        (folder / name / "labels.jsonl").unlink()
        shutil.rmtree(folder / name / "truth")


def test_the_campaign_runs_without_labels_and_takes_up_where_it_stopped(
    blind, sets, tmp_path, monkeypatch
):
    """On the shipped campaign, with another folder; a failure stops nothing."""
    without_labels(sets)
    calls = []

    def diagnose(problem, effects, rng):
        calls.append((len(effects), rng.integers(1 << 30)))
        if len(calls) == 1:
            raise ArithmeticError("no luck")
        return diagnosed(blind, problem)

    monkeypatch.setattr(blind.run.diagnose, "diagnose", diagnose)
    monkeypatch.setattr(
        blind.run, "baseline_answers", lambda problem, effects: {"harmonic": []}
    )
    text = (ROOT / "benchmarks" / "blind.campaign.toml").read_text("utf-8")
    file, out = tmp_path / "blind.campaign.toml", tmp_path / "out"
    (tmp_path / "case.py").write_text("from benchmarks.blind.case import *\n", "utf-8")
    text = text.replace('"out/blind"', json.dumps(str(sets)))
    file.write_text(text.replace("blind/case.py:", "case.py:"), "utf-8")
    arguments = ["campaign", str(file), "--out", str(out), "--workers", "1"]
    assert main([*arguments, "--seeds", "1"]) == 0
    assert len(calls) == 1
    assert main([*arguments, "--seeds", "3"]) == 0
    assert main([*arguments, "--seeds", "3"]) == 0
    assert len(calls) == 5  # three cases, one of them without an effect, one pair
    assert sorted(n for n, _ in calls) == [calls[0][0] - 1, *[calls[0][0]] * 4]
    names = (sets / "set" / "order.txt").read_text("utf-8").split()
    found = blind.results.read(out)
    assert list(found.every) == names[:3]
    assert list(found.withheld) == [names[1]]
    assert list(found.pairs) == [names[2]]
    assert found.withheld[names[1]]["without"] == "step"
    assert found.every[names[0]]["failure"] == "ArithmeticError: no luck"
    record = found.every[names[1]]
    assert record["answers"][1] == {
        "effects": ["step"],
        "probability": 0.1,
        "classes": [["step", "mount_drift"]],
    }
    assert record["closure"][0]["value"] is None
    law = blind.run.law_of(record["law"])
    assert law.law.scale[0, 0] == pytest.approx(2.0**0.5)
    assert math.isinf(law.student_dof)
    summary = pd.read_csv(out / "summary.csv")
    assert summary["diagnoses"].tolist() == [3, 1, 1]
    assert summary["failures"].tolist() == [1, 0, 0]


def test_cases_keep_their_numbers_and_their_draws(blind, sets):
    names = (sets / "set" / "order.txt").read_text("utf-8").split()
    jobs = [blind.case.job_of(sets, "all", k) for k in range(len(names))]
    assert [job.case.id for job in jobs] == names
    assert blind.case.job_of(sets, "withheld", 0) is None
    first, again = (blind.run.random_stream(jobs[0]).random() for _ in range(2))
    assert first == again != blind.run.random_stream(jobs[1]).random()
    with pytest.raises(ValueError, match="draw more with `generate`"):
        blind.case.job_of(sets, "all", len(names))
    with pytest.raises(ValueError, match="there are all, withheld, pairs"):
        blind.case.job_of(sets, "every", 0)
    options = {"name": "dev", "machines": ["a3"], "kinds": ["null"]}
    with pytest.raises(ValueError, match="another folder"):
        blind.write.generate(sets / "set", count=2, seed=3, **options)


def test_who_knows_the_noise_is_given_its_covariance(blind, sets, monkeypatch):
    covariances = []

    def diagnose(problem, effects, rng, *, law):
        whitened = law.factor(problem.structure).whiten(
            np.eye(len(problem))
        )  # W, with W^T W the inverse of the covariance, which the search sees
        covariances.append(np.linalg.inv(whitened.T @ whitened))
        return diagnosed(blind, problem)

    monkeypatch.setattr(blind.known_noise.diagnose, "diagnose", diagnose)
    setting = {"folder": str(sets), "part": "all"}
    records = [blind.known_noise.diagnosis(setting, seed) for seed in (0, 1)]
    jobs = [blind.case.job_of(sets, "all", seed) for seed in (0, 1)]
    for job, record, whole in zip(jobs, records, covariances, strict=True):
        assert record["answers"][0]["effects"] == []
        problem = blind.loading.prepare(job.folder, job.case)
        with np.load(job.folder / "truth" / f"{job.case.id}.npz") as truth:
            wanted = blind.write.covariance(truth) / np.outer(
                problem.sigma, problem.sigma
            )
        np.testing.assert_allclose(whole, wanted, atol=1e-9 * wanted.max())


def test_lists_name_cases_and_what_is_withheld(blind, blind_case_set, tmp_path):
    listed = tmp_path / "list.jsonl"
    count = blind.listing.write(
        blind_case_set, listed, kinds=["single"], least=4.0, withhold=True
    )
    lines = [json.loads(text) for text in listed.read_text("utf-8").splitlines()]
    labels = {label["id"]: label for label in blind.entries.labels(blind_case_set)}
    assert len(lines) == count > 0
    for line in lines:
        (effect,) = labels[line["id"]]["effects"]
        assert effect["name"] == line["without"]
        assert effect["target"] >= 4.0
    nothing = {"kinds": ["single"], "least": 1e3}
    assert blind.listing.write(blind_case_set, listed, or_none=True, **nothing) == 0
    assert listed.read_text("utf-8") == ""
    with pytest.raises(ValueError, match="there are exact, null"):
        blind.listing.write(blind_case_set, listed, kinds=["sngle"])


@pytest.mark.slow
def test_lists_keep_effects_that_can_be_told_from_every_rival(
    blind, blind_case_set, tmp_path
):
    """By the oracle's own figures, those that the scorer goes by."""
    listed = tmp_path / "list.jsonl"
    count = blind.listing.write(
        blind_case_set,
        listed,
        kinds=["single", "pair"],
        least=6.0,
        apart=6.0,
        workers=1,
    )
    names = {
        json.loads(line)["id"]
        for line in listed.read_text(encoding="utf-8").splitlines()
    }
    labels = {
        v["id"]: v
        for v in blind.entries.labels(blind_case_set)
        if v["kind"] in ("single", "pair")
    }
    labels = {
        n: v for n, v in labels.items() if min(e["target"] for e in v["effects"]) >= 6.0
    }
    acting = {n: [e["name"] for e in v["effects"]] for n, v in labels.items()}
    records: dict[str, dict] = {name: {} for name in labels}
    figures = blind.oracle.run(
        blind_case_set, records, acting, tmp_path, workers=1, report=str
    )
    entries = [blind.entries.entry(v, figures[n], {}) for n, v in labels.items()]
    apart = {
        e.label["id"]
        for e in entries
        if e.testable and e.severity >= 6.0 and e.separation >= 6.0
    }
    assert names == apart
    assert 0 < count == len(apart) < len(labels)
    with pytest.raises(ValueError, match="a lower --least or --apart"):
        blind.listing.write(
            blind_case_set, listed, kinds=["single"], least=20.0, apart=1e6, workers=1
        )
