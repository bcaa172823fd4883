"""The blind benchmark's runner, oracle and baselines: labels stay shut, figures are
those of dense formulas.
"""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

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
    "pool",
    "run",
    "stepwise",
    "generator.severity",
    "generator.write",
)


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The benchmark's modules."""
    return blind_modules(*NAMES)


@pytest.fixture(scope="module")
def case_set(blind: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small set: cases of one effect or two on the A3."""
    folder = tmp_path_factory.mktemp("set")
    blind.write.generate(
        folder,
        name="dev",
        count=24,
        seed=3,
        machines=["a3"],
        kinds=["null", "single", "pair", "exact"],
    )
    return folder


# -- the runner ------------------------------------------------------------------------


def test_the_runner_cannot_know_labels():
    """Neither imports nor names what only the scorer may open."""
    for name in ("run", "loading", "harmonic", "stepwise", "pool"):
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
    blind, case_set, tmp_path, monkeypatch
):
    folder, out = tmp_path / "set", tmp_path / "results"
    folder.mkdir()
    shutil.copy(case_set / "manifest.jsonl", folder)
    shutil.copytree(case_set / "cases", folder / "cases")
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
    blind, case_set, tmp_path, monkeypatch
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
                str(case_set),
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
    jobs = sorted(blind.run.select_jobs(case_set, limit=2), key=lambda j: j.case.study)
    for job, (whole, parts) in zip(jobs, covariances, strict=True):
        record = json.loads(
            (tmp_path / "known_noise" / f"{job.case.id}.json").read_text(
                encoding="utf-8"
            )
        )
        assert record["answers"][0]["effects"] == []
        problem = blind.loading.prepare(case_set, job.case)
        with np.load(case_set / "truth" / f"{job.case.id}.npz") as truth:
            wanted = blind.write.covariance(truth) / np.outer(
                problem.sigma, problem.sigma
            )
        np.testing.assert_allclose(whole, wanted, atol=1e-9 * wanted.max())
        for members, part in zip(problem.members, parts, strict=False):
            assert np.array_equal(part, wanted[np.ix_(members[rows], members[rows])])
    assert (
        blind.known_noise.run_all(case_set, tmp_path, limit=2, workers=1, report=str)
        == 0
    )
    assert len(covariances) == 2  # what is there is not made again


def test_every_effect_is_withheld_in_turn(blind, case_set):
    jobs = blind.run.select_jobs(case_set, limit=1, without="each")
    assert [j.without for j in jobs] == [
        e.name for e in blind.loading.bench(jobs[0].case.study).effects
    ]


def test_lists_name_cases_and_what_is_withheld(blind, case_set, tmp_path):
    listed = tmp_path / "list.jsonl"
    count = blind.listing.write(
        case_set, listed, kinds=["single"], least=4.0, withhold=True
    )
    jobs = blind.run.select_jobs(case_set, listed=listed)
    labels = {label["id"]: label for label in blind.entries.labels(case_set)}
    assert len(jobs) == count > 0
    assert all(
        [e["name"] for e in labels[j.case.id]["effects"]] == [j.without] for j in jobs
    )
    assert all(labels[j.case.id]["effects"][0]["target"] >= 4.0 for j in jobs)
    with pytest.raises(ValueError, match="there are exact, null"):
        blind.listing.write(case_set, listed, kinds=["sngle"])


def test_lists_keep_effects_that_can_be_told_from_every_rival(
    blind, case_set, tmp_path
):
    """By the oracle's own figures, those that the scorer goes by."""
    listed = tmp_path / "list.jsonl"
    count = blind.listing.write(
        case_set, listed, kinds=["single", "pair"], least=6.0, apart=6.0, workers=1
    )
    names = {
        json.loads(line)["id"]
        for line in listed.read_text(encoding="utf-8").splitlines()
    }
    labels = {
        v["id"]: v
        for v in blind.entries.labels(case_set)
        if v["kind"] in ("single", "pair")
    }
    labels = {
        n: v for n, v in labels.items() if min(e["target"] for e in v["effects"]) >= 6.0
    }
    cases = [c for c in blind.loading.manifest(case_set) if c.id in labels]
    acting = {n: [e["name"] for e in v["effects"]] for n, v in labels.items()}
    figures = blind.oracle.run(
        case_set, tmp_path / "results", cases, acting, workers=1, report=str
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
            case_set, listed, kinds=["single"], least=20.0, apart=1e6, workers=1
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
    blind, case_set, tmp_path, capsys, monkeypatch, options, message
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert (
        blind.main(
            [
                "run",
                "--cases",
                str(case_set),
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


def test_jobs_go_to_a_cluster_and_come_back_with_their_results(blind, monkeypatch):
    class Client:
        def __init__(self, address: str) -> None:
            assert address == "tcp://there:8786"

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def map(self, work, jobs, pure):
            assert not pure
            return [
                SimpleNamespace(key=f"k{j}", result=lambda j=j: work(j)) for j in jobs
            ]

    cluster = ModuleType("distributed")
    cluster.Client, cluster.as_completed = Client, lambda futures: reversed(futures)
    monkeypatch.setitem(sys.modules, "distributed", cluster)
    assert list(
        blind.pool.results(lambda j: j * j, [2, 3], dask="tcp://there:8786")
    ) == [(3, 9), (2, 4)]


# -- the oracle ------------------------------------------------------------------------


def test_what_a_rival_leaves_is_that_of_a_wider_covariance(blind):
    """sqrt(lambda_k|j) by the Schur complement against the dense metric in which the
    rival is one more Gaussian.
    """
    from oed.gap.forms.library import Atom, Library

    rng = np.random.default_rng(5)
    n, J, prior = 40, rng.normal(size=(40, 4)), np.array([3.0, 1.0, 0.5, 2.0])
    root = rng.normal(size=(n, n)) / 8
    sigma = np.eye(n) + root @ root.T
    columns, dy = rng.normal(size=(n, 5)) * 0.4, rng.normal(size=n)
    forms = {"one": [0, 1], "two": [2, 3, 4], "two alone": [3]}
    atoms = tuple(
        Atom(name.split()[0], {}, np.array(c), 0.0) for name, c in forms.items()
    )
    library = Library(columns, atoms, tuple("abcde"), ("",) * 5, np.ones(5), {})
    metric = blind.severity.Metric(sigma, J, prior)
    distances = blind.oracle.effect_distances(
        metric.embed(dy), metric.embed(columns), library
    )
    for name, expected in distances.items():
        dense = []
        for label, c in forms.items():
            wide = (
                sigma
                + (J * prior**2) @ J.T
                + blind.oracle.RIVAL**2 * columns[:, c] @ columns[:, c].T
            )
            if label.split()[0] == name:
                dense.append(float(dy @ np.linalg.solve(wide, dy)))
        assert expected == pytest.approx(math.sqrt(min(dense)), rel=1e-9)


def test_legs_are_tied_where_each_would_make_the_same_readings(blind):
    """Two legs whose forms span the same, a third that has more; not where none of them
    makes much of the change.
    """
    from oed.gap.forms.library import Atom, Library

    rng = np.random.default_rng(6)
    same, third = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    columns = 20.0 * np.hstack([same, same @ [[0.6, 0.8], [-0.8, 0.6]], third])
    atoms = tuple(Atom("lost", {}, np.array([2 * k, 2 * k + 1]), 0.0) for k in range(3))
    library = Library(
        columns,
        atoms,
        tuple("abcdef"),
        tuple(f"leg {k // 2 + 1}" for k in range(6)),
        np.ones(6),
        {},
    )
    change = same @ [2.0, 1.0]
    assert blind.oracle.tied_legs(change, columns, library, "lost") == [
        ["leg 1", "leg 2"]
    ]
    assert blind.oracle.tied_legs(third @ [2.0, 1.0], columns, library, "lost") == []
    assert blind.oracle.tied_legs(rng.normal(size=30), columns, library, "lost") == []
    assert blind.oracle.tied_legs(change, columns, library, "other") == []


def test_what_forms_in_one_leg_leave(blind):
    """The least over effects and forms of a leg; forms over several legs, and those of
    no leg, are none of any leg.
    """
    from oed.gap.forms.library import Atom, Library

    columns = 1e6 * np.eye(5)
    spans = {"a": ([0], [1], [0, 2]), "b": ([3], [4])}
    atoms = tuple(
        Atom(name, {}, np.array(c), 0.0)
        for name, all_of in spans.items()
        for c in all_of
    )
    labels = ("leg 1", "leg 2", "leg 2", "leg 1", "bar")
    library = Library(columns, atoms, tuple("vwxyz"), labels, np.ones(5), {})
    change = np.array(
        [4.0, 2.0, 1.0, 3.0, 6.0]
    )  # |seen|^2 = 66; one column takes its own entry
    distances = blind.oracle.leg_distances(change, columns, library)
    assert distances == pytest.approx(
        {"leg 1": math.sqrt(66 - 16), "leg 2": math.sqrt(66 - 4)}
    )
    distances = blind.oracle.leg_distances(change, columns, library, "b")
    assert distances == pytest.approx({"leg 1": math.sqrt(66 - 9)})


def test_oracle_of_generated_cases(blind, case_set, tmp_path):
    labels = {label["id"]: label for label in blind.entries.labels(case_set)}
    cases = {c.id: c for c in blind.loading.manifest(case_set)}
    for kind in ("single", "pair", "exact"):
        name = next(n for n, label in labels.items() if label["kind"] == kind)
        names = tuple(e["name"] for e in labels[name]["effects"])
        figures = json.loads(
            blind.oracle.work(
                blind.oracle.OracleJob(case_set, tmp_path, cases[name], names)
            )
        )
        for e, label in zip(figures["effects"], labels[name]["effects"], strict=True):
            assert e["sqrt_lambda"] == pytest.approx(label["sqrt_lambda"], rel=1e-3)
            assert e["given_others"] == pytest.approx(label["target"], rel=0.02)
            assert 0.0 <= e["beyond"] <= e["apart"] <= e["given_others"] + 1e-9
            if kind == "exact":
                assert e["apart"] < 1.0  # the other member takes it over
        whole = next(c for c in figures["closure"] if c["split"] == "whole")
        assert whole["expected_gain"] > 0.0
        assert whole["same_law"] is None  # there is no result yet


def test_oracle_of_two_effects_is_that_of_the_dense_metric(blind, case_set, tmp_path):
    """What else acts is absorbed first, with no bound on its size, then a rival; which
    never is what acts.
    """
    from oed.gap.forms import library as library_of

    label = next(e for e in blind.entries.labels(case_set) if e["kind"] == "pair")
    chosen = next(c for c in blind.loading.manifest(case_set) if c.id == label["id"])
    names = tuple(e["name"] for e in label["effects"])
    figures = json.loads(
        blind.oracle.work(blind.oracle.OracleJob(case_set, tmp_path, chosen, names))
    )["effects"]
    problem = blind.loading.prepare(case_set, chosen)
    library = library_of.build(problem, blind.loading.bench(chosen.study).effects)
    with np.load(case_set / "truth" / f"{chosen.id}.npz") as arrays:
        truth = {n: arrays[n] for n in arrays.files}
    J = truth["J"].astype(float) * truth["prior"]
    geometry = blind.write.covariance(truth) + J @ J.T
    for k, e in enumerate(figures):
        dy, other = truth[f"dy_{k}"], truth[f"dy_{1 - k}"]
        covariance = geometry + 1e6 * np.outer(other, other)
        assert e["given_others"] == pytest.approx(
            math.sqrt(dy @ np.linalg.solve(covariance, dy)), rel=1e-4
        )
        assert e["sqrt_lambda"] > e["given_others"]
        assert not {e["nearest"]} & set(names)
        energies = []
        for number in library.atoms_of(e["nearest"]):
            columns = (
                3.0
                * library.columns[:, library.atoms[number].columns]
                * problem.sigma[:, None]
            )
            energies.append(dy @ np.linalg.solve(covariance + columns @ columns.T, dy))
        assert e["apart"] == pytest.approx(math.sqrt(min(energies)), rel=1e-3)


def test_oracle_refuses_readings_of_another_case(blind, case_set, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(case_set, folder)
    one, two = [c for c in blind.loading.manifest(folder) if c.plan == "a3_full"][:2]
    shutil.copy(folder / two.readings, folder / one.readings)
    with pytest.raises(ValueError, match="make the set again"):
        blind.oracle.work(blind.oracle.OracleJob(folder, tmp_path, one, ()))


# -- the baselines ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def problem(blind, case_set):
    """A null case of the A3's full plan."""
    wanted = next(c for c in blind.loading.manifest(case_set) if c.plan == "a3_full")
    return blind.loading.prepare(case_set, wanted)


def clean(problem, seed: int):
    """White noise in place of the residuals, and parameters within their tolerances."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=problem.slopes.shape[1])
    return problem.with_residual(rng.normal(size=len(problem)) + problem.slopes @ theta)


def test_stepwise_takes_the_form_of_least_bic(blind, problem):
    """Against explicit least squares with a row a parameter for its tolerance."""
    from oed.gap.forms import library as library_of

    effects = [
        e
        for e in blind.loading.bench("a3_full.study.toml").effects
        if e.name in ("servo_lag", "gravity", "bar_length")
    ]
    library = library_of.build(problem, effects)
    lag = next(
        a for a in library.atoms if a.effect == "servo_lag" and len(a.columns) > 1
    )
    quiet = clean(problem, 1)
    acting = quiet.with_residual(
        quiet.residual
        + library.columns[:, lag.columns] @ np.full(len(lag.columns), 0.5)
    )
    assert blind.stepwise.stepwise(quiet, library) == []

    def bic(columns) -> float:
        n, m = problem.slopes.shape
        design = np.block(
            [
                [problem.slopes, library.columns[:, columns]],
                [np.eye(m), np.zeros((m, len(columns)))],
            ]
        )
        target = np.concatenate([acting.residual, np.zeros(m)])
        scale = np.linalg.norm(design, axis=0)
        residual = (
            target
            - (design / scale) @ np.linalg.lstsq(design / scale, target, rcond=1e-12)[0]
        )
        return n * math.log(residual @ residual) + len(columns) * math.log(n)

    bics = {
        k: bic(a.columns) + len(a.constants) * math.log(len(problem))
        for k, a in enumerate(library.atoms)
    }
    best = min(bics, key=lambda k: bics[k])
    assert bics[best] < bic([])
    assert (
        blind.stepwise.stepwise(acting, library)[0]
        == library.atoms[best].effect
        == "servo_lag"
    )


def test_harmonic_rules_are_silent_at_white_noise(blind, problem):
    names = [e.name for e in blind.loading.bench("a3_full.study.toml").effects]
    alarms = sum(
        bool(blind.harmonic.harmonic(clean(problem, seed), names)) for seed in range(20)
    )
    assert alarms <= 2  # set for 1 %: three and more have a chance of 0.1 %


@pytest.mark.parametrize("symptom", ["lag", "payload", "jump"])
def test_harmonic_rules_name_what_stands_out(blind, problem, symptom):
    rows, quiet = problem.rows, clean(problem, 4)
    phase, last = rows["phase"].to_numpy(), rows["time"].max()
    change = {
        "lag": (
            rows["direction"] * rows["feed"] / rows["feed"].max() * np.cos(2 * phase)
        ),
        "payload": rows["payload"] / rows["payload"].max() * np.cos(3 * phase),
        "jump": (rows["time"] > 0.3 * last) * 1.0,
    }[symptom]
    named = blind.harmonic.harmonic(
        quiet.with_residual(quiet.residual + 5.0 * np.asarray(change, dtype=float)),
        [e.name for e in blind.loading.bench("a3_full.study.toml").effects],
    )
    assert (
        named[0] == {"lag": "servo_lag", "payload": "gravity", "jump": "step"}[symptom]
    )
