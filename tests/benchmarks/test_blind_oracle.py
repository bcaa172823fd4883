"""The blind benchmark's oracle: its figures are those of dense formulas."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The benchmark's modules."""
    return blind_modules(
        "entries", "loading", "oracle", "generator.severity", "generator.write"
    )


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


def test_oracle_of_generated_cases(blind, blind_case_set, tmp_path):
    labels = {label["id"]: label for label in blind.entries.labels(blind_case_set)}
    cases = {c.id: c for c in blind.loading.manifest(blind_case_set)}
    for kind in ("single", "pair", "exact"):
        name = next(n for n, label in labels.items() if label["kind"] == kind)
        names = tuple(e["name"] for e in labels[name]["effects"])
        figures = blind.oracle.work(
            blind.oracle.OracleJob(blind_case_set, cases[name], names)
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


@pytest.mark.slow
def test_oracle_of_two_effects_is_that_of_the_dense_metric(
    blind, blind_case_set, tmp_path
):
    """What else acts is absorbed first, with no bound on its size, then a rival; which
    never is what acts.
    """
    from oed.gap.forms import library as library_of

    label = next(e for e in blind.entries.labels(blind_case_set) if e["kind"] == "pair")
    chosen = next(
        c for c in blind.loading.manifest(blind_case_set) if c.id == label["id"]
    )
    names = tuple(e["name"] for e in label["effects"])
    figures = blind.oracle.work(blind.oracle.OracleJob(blind_case_set, chosen, names))[
        "effects"
    ]
    problem = blind.loading.prepare(blind_case_set, chosen)
    library = library_of.build(problem, blind.loading.bench(chosen.study).effects)
    with np.load(blind_case_set / "truth" / f"{chosen.id}.npz") as arrays:
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


def test_oracle_refuses_readings_of_another_case(blind, blind_case_set, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(blind_case_set, folder)
    one, two = [c for c in blind.loading.manifest(folder) if c.plan == "a3_full"][:2]
    shutil.copy(folder / two.readings, folder / one.readings)
    with pytest.raises(ValueError, match="make the set again"):
        blind.oracle.work(blind.oracle.OracleJob(folder, one, ()))
