"""The blind benchmark's runner: labels stay shut, interrupted runs go on."""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from oed.noise.law import Whitener

ROOT = Path(__file__).resolve().parents[1]


BLIND = ROOT / "benchmarks" / "blind"


NAMES = (
    "entries",
    "harmonic",
    "known_noise",
    "listing",
    "loading",
    "oracle",
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
    for name in ("run", "loading", "harmonic", "stepwise"):
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
    from oed.gap.data.diagnosis import Answer, Block, Closure, Diagnosis
    from oed.noise.law import stated_law

    answers = (Answer((), 0.9), Answer(("step",), 0.1, (("step", "mount_drift"),)))
    nothing = np.zeros(len(problem))
    fields = {f.name: () for f in dataclasses.fields(Diagnosis)} | {
        "problem": problem, "verdict": "none", "answers": answers, "set95": answers, "marginal": {"step": 0.1},
        "law": dataclasses.replace(stated_law(problem), variance=np.linspace(1.0, 2.0, len(problem))),
        "explained": nothing, "unexplained": nothing, "before": nothing, "after": nothing,
        "where": (Block("leg 1", 0.5, 0.1),), "not_testable": {},
        "closure": (Closure("whole", math.nan, -math.inf, math.inf, 0.5, 1.0, 1.1, 1.0, 10),),
    }  # fmt: skip
    return Diagnosis(**fields)


def test_runs_without_labels_and_takes_up_where_it_stopped(
    blind, blind_case_set, tmp_path, monkeypatch
):
    folder, out = tmp_path / "set", tmp_path / "results"
    folder.mkdir()
    shutil.copy(blind_case_set / "manifest.jsonl", folder)
    shutil.copytree(blind_case_set / "cases", folder / "cases")
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
    assert blind.run.run(folder, out, limit=2, workers=1, report=str) == 1
    assert (
        blind.run.run(folder, out, limit=2, workers=1, report=str) == 0
    )  # the failed one again, and that alone
    assert blind.run.run(folder, out, limit=2, workers=1, report=str) == 0
    assert len(calls) == 3
    assert calls[0] == calls[2]  # the same draws
    names = [c.id for c in blind.loading.manifest(folder)[:2]]
    record = json.loads((out / f"{names[0]}.json").read_text(encoding="utf-8"))
    assert record["answers"][1] == {
        "effects": ["step"],
        "probability": 0.1,
        "classes": [["step", "mount_drift"]],
    }
    assert record["closure"][0]["value"] is None
    law = blind.run.law_of(record["law"], len(record["law"]["variance"]))
    assert law.variance[-1] == 2.0
    assert math.isinf(law.student_dof)
    assert (
        blind.run.run(folder, out, limit=1, without="step", workers=1, report=str) == 0
    )
    assert calls[3][0] == calls[2][0] - 1
    assert (out / "without" / "step" / f"{names[0]}.json").is_file()


def test_who_knows_the_noise_is_given_its_covariance(
    blind, blind_case_set, tmp_path, monkeypatch
):
    covariances, rows = [], np.array([0, 2, 3])

    def diagnose(problem, effects, rng, *, law):
        white = Whitener(problem, law)
        whitened = white.whiten(
            np.eye(len(problem))
        )  # W, with W^T W the inverse of the covariance, which the search sees
        covariances.append(
            (
                np.linalg.inv(whitened.T @ whitened),
                [law.block(problem, k, rows) for k in range(3)],
            )
        )
        return diagnosed(blind, problem)

    monkeypatch.setattr(blind.known_noise.diagnose, "diagnose", diagnose)
    assert (
        blind.main(
            [
                "known-noise",
                "--cases",
                str(blind_case_set),
                "--results",
                str(tmp_path),
                "--limit",
                "2",
                "--workers",
                "1",
            ]
        )
        == 0
    )
    jobs = sorted(
        blind.run.select_jobs(blind_case_set, limit=2), key=lambda j: j.case.study
    )
    for job, (whole, parts) in zip(jobs, covariances, strict=True):
        record = json.loads(
            (tmp_path / "known_noise" / f"{job.case.id}.json").read_text(
                encoding="utf-8"
            )
        )
        assert record["answers"][0]["effects"] == []
        problem = blind.loading.prepare(blind_case_set, job.case)
        with np.load(blind_case_set / "truth" / f"{job.case.id}.npz") as truth:
            wanted = blind.write.covariance(truth) / np.outer(
                problem.sigma, problem.sigma
            )
        np.testing.assert_allclose(whole, wanted, atol=1e-9 * wanted.max())
        for members, part in zip(problem.members, parts, strict=False):
            assert np.array_equal(part, wanted[np.ix_(members[rows], members[rows])])
    assert (
        blind.known_noise.run_all(
            blind_case_set, tmp_path, limit=2, workers=1, report=str
        )
        == 0
    )
    assert len(covariances) == 2  # what is there is not made again


def test_every_effect_is_withheld_in_turn(blind, blind_case_set):
    jobs = blind.run.select_jobs(blind_case_set, limit=1, without="each")
    assert [j.without for j in jobs] == [
        e.name for e in blind.loading.bench(jobs[0].case.study).effects
    ]


def test_lists_name_cases_and_what_is_withheld(blind, blind_case_set, tmp_path):
    listed = tmp_path / "list.jsonl"
    count = blind.listing.write(
        blind_case_set, listed, kinds=["single"], least=4.0, withhold=True
    )
    jobs = blind.run.select_jobs(blind_case_set, listed=listed)
    labels = {label["id"]: label for label in blind.entries.labels(blind_case_set)}
    assert len(jobs) == count > 0
    assert all(
        [e["name"] for e in labels[j.case.id]["effects"]] == [j.without] for j in jobs
    )
    assert all(labels[j.case.id]["effects"][0]["target"] >= 4.0 for j in jobs)
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
    cases = [c for c in blind.loading.manifest(blind_case_set) if c.id in labels]
    acting = {n: [e["name"] for e in v["effects"]] for n, v in labels.items()}
    figures = blind.oracle.run(
        blind_case_set, tmp_path / "results", cases, acting, workers=1, report=str
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "a4"], "there are a3, a3_"),
        (["--without", "back_lash"], "no such effect; there are backlash"),
        (["--dask", "tcp://nowhere:1"], "not installed"),
    ],
)
def test_bad_options_are_told_with_what_there_is(
    blind, blind_case_set, tmp_path, capsys, monkeypatch, options, message
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert (
        blind.main(
            [
                "run",
                "--cases",
                str(blind_case_set),
                "--out",
                str(tmp_path),
                "--workers",
                "1",
                *options,
            ]
        )
        == 2
    )
    assert message in capsys.readouterr().err
