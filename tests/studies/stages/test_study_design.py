"""Criteria of a study's [design], robust plans and numbers of readings, against all subsets."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import design_sample as small
import numpy as np
import pytest
import sample
from design_sample import CUP, EXTRA, GRID, KNOWN, chosen, rows, section, text, value

from oed import identifiability
from oed.measurement import Measurement, Series
from pkm_studies import stages, study
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.results import load_result


# -- criteria: all 56 choices of 3 readings out of 8 -----------------------------------
@pytest.mark.parametrize("name", [
    *("D", "Ds", "c", "I", "kappa"),
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("A", "G", "O1", "O2", "O5")),
])  # fmt: skip
def test_no_subset_is_better_nor_above_the_bound(name):
    resolved, design = chosen(text(f'criterion = "{name}"\n' + KNOWN + EXTRA))
    h = rows(resolved)
    best = max(
        value(name, h[list(subset)], resolved)
        for subset in itertools.combinations(range(8), 3)
    )
    sign = -1.0 if name == "kappa" else 1.0
    report = section(resolved, design)
    size = abs(best)
    assert sign * design.choice.value == pytest.approx(
        value(name, h[design.choice.indices], resolved), rel=1e-5
    )
    assert sign * design.choice.value == pytest.approx(best, abs=2e-5 * size)
    assert report.bound is not None
    assert sign * report.bound >= best - 1e-5 * size
    assert report.plans[0].value == pytest.approx(report.value, rel=1e-7)
    assert report.words.startswith(("Proven optimal", "Certified to"))


@pytest.mark.parametrize("name", ["E", "O3", "O4"])
def test_eigenvalues_without_tolerances(name):
    """18 of 20 readings, over the directions that all of them see."""
    tables = GRID.format(name="cup").replace("230", "200, 230")
    tables = tables.replace("[1086, 1246]", "[1086, 1146, 1206, 1266]")
    fields = f'criterion = "{name}"\nreadings = 18\n'
    resolved, design = chosen(text(fields, tables=tables))
    m = resolved.measurement
    h = (m.jacobian(resolved.candidates, m.nominal) / m.length_factors)[:, m.free]
    assert len(h) == 20
    seen = h @ np.linalg.svd(h, full_matrices=False)[2][: design.choice.directions].T
    values = []
    for out in itertools.combinations(range(20), 2):
        left = np.delete(seen, out, axis=0)
        w = np.linalg.eigvalsh(left.T @ left)
        least = max(w[0], 0.0)
        by_name = {"E": w[0], "O3": np.sqrt(least), "O4": w[0] / np.sqrt(w[-1])}
        values.append(by_name[name])
    assert design.choice.value == pytest.approx(max(values), rel=1e-5)
    assert "directions that the candidates see" in section(resolved, design).words


def test_compound_is_the_mean_of_logarithms():
    resolved, design = chosen(text("compound = { D = 3.0, A = 1.0 }\n" + KNOWN))
    h = rows(resolved)

    def mean(subset: tuple[int, ...]) -> float:
        one = value("D", h[list(subset)], resolved) / h.shape[1]
        return 0.75 * one - 0.25 * float(np.log(-value("A", h[list(subset)], resolved)))

    best = max(mean(subset) for subset in itertools.combinations(range(8), 3))
    assert design.choice.value == pytest.approx(best, rel=1e-6)
    assert section(resolved, design).compound == {"D": 3.0, "A": 1.0}


def test_compared_designs_score_each_other():
    fields = 'criterion = "D"\ncompare = ["A", "c"]\n' + KNOWN + EXTRA
    resolved, design = chosen(text(fields))
    h, table = rows(resolved), {c.name: c for c in design.compared}
    assert list(table) == ["D", "A", "c"]
    assert table["D"].gain == 1.0
    for name in ("A", "c"):
        of_d = table[name].values["D"]
        best = value(name, h[design.choice.indices], resolved)
        assert table[name].gain >= 1.0
        assert of_d == pytest.approx(best, rel=1e-5)
        gain = of_d / table[name].values[name]
        assert table[name].gain == pytest.approx(gain, rel=1e-6)


def test_predicted_accuracy_is_that_of_the_prediction(tmp_path):
    reference = (
        GRID.format(name="cup")
        .replace("candidates", "reference")
        .replace('"cup"', '"cup"\nname = "given"')
    )
    parsed = study.Study.parse(
        text("criterion = 'I'\n" + KNOWN, tables=GRID.format(name="cup") + reference),
        Path("x.study.toml"),
    )
    result = stages.run_study(parsed, tmp_path, report=False)
    plan, given = result.design.plans
    for name, component in result.prediction.components.items():
        key = f"{name}_{result.prediction.unit[name]}"
        # The prediction is the mean over drawn machines, the plan's of the nominal one.
        assert plan.predicted[key] == pytest.approx(component.known.rms, rel=5e-3)
        assert plan.gain[key] == pytest.approx(
            given.predicted[key] / plan.predicted[key]
        )
    assert given.n == 8
    assert given.gain["x_um"] == 1.0


# -- instruments -----------------------------------------------------------------------
def log_det(m: Measurement, series: Sequence[Series]) -> float:
    """Of the information with the prior, in units of the tolerances."""
    h = identifiability.scaled(m, series, m.nominal, "tolerance")[:, m.free]
    return float(np.linalg.slogdet(h.T @ h + np.eye(h.shape[1]))[1])


def test_readings_that_share_a_reference():
    """Readings against one reference are correlated, and so is their identifiability."""
    planar = (
        'schema = 1\nname = "small"\nmachine = { model = "planar_2dof"'
        ' }\n[[setup]]\nname = "rm5"\ninstrument = "rm5"\n'
    )
    fields = (
        '[design]\nreadings = 4\nscaling = "tolerance"\nprior ='
        ' true\n[[design.candidates]]\nsetup = "rm5"\n'
    )
    grid = 'y_mm = [0, -1200, -600, 600, 1200]\nz_mm = [0, 750, 1500]\nruns_by = "z"\n'
    resolved, design = chosen(planar + fields + grid)
    m, (whole,) = resolved.measurement, resolved.candidates
    assert len(whole) == 12
    subsets = itertools.combinations(range(12), 4)
    best = max(log_det(m, [whole.take(np.array(subset))]) for subset in subsets)
    assert design.choice.value == pytest.approx(best, rel=1e-8)
    assert log_det(m, list(design.series)) == pytest.approx(best, rel=1e-8)
    by_e = fields.replace("readings = 4", 'readings = 4\ncriterion = "E"')
    with pytest.raises(InputError, match="does not profile out"):
        chosen(planar + by_e + grid)


def test_instruments_with_different_channels():
    tracker = '[[setup]]\nname = "tracker"\ninstrument = "pose_tracker"\n'
    resolved, design = chosen(
        text(KNOWN, tables=GRID.format(name="cup") + TRACKED, setups=CUP + tracker)
    )
    m = resolved.measurement
    bar, tracked = resolved.candidates
    assert len(m.setups["cup"].sigma) != len(m.setups["tracker"].sigma)
    subsets = (np.array(subset) for subset in itertools.combinations(range(12), 3))
    by_setup = ([(bar, s[s < 8]), (tracked, s[s >= 8] - 8)] for s in subsets)
    plans = ([series.take(k) for series, k in parts if k.size] for parts in by_setup)
    best = max(log_det(m, plan) for plan in plans)
    assert design.choice.value == pytest.approx(best, rel=1e-8)
    assert log_det(m, list(design.series)) == pytest.approx(best, rel=1e-8)


TRACKED = """
[[design.candidates]]
setup = "tracker"
z_mm = [1086, 1246]
psi_deg = [0, 130]
theta_deg = 20
"""


# -- refusals --------------------------------------------------------------------------
REFUSED = {
    "criterion and compound": ('criterion = "A"\ncompound = { D = 1.0 }', "design.compound", "keep criterion or"),
    "unknown part": ("compound = { F = 1.0 }", "design.compound.F", "no such criterion"),
    "negative share": ("compound = { D = -1.0 }", "design.compound.D", "> 0"),
    "I alone": ('criterion = "I"', "design.criterion", "prior = true"),
    "c of nothing": ('criterion = "c"', "design.criterion", "add combination"),
    "combination": ("combination = { dq9 = 1.0 }", "design.combination.dq9", "did you mean dq"),
    "interest": ('interest = ["xx*"]', "design.interest[1]", "no parameter"),
    "accuracy": ("accuracy = { x_deg = 1.0 }", "design.accuracy.x_deg", "x_um"),
    "apart": ("apart = { phi_deg = 1.0 }", "design.apart.phi_deg", "did you mean psi_deg"),
    "set-ups": ("setups_max = 1", "design.setups_max", "prior = true"),
    "keep": ('keep = "former"', "design.keep", "no such reference plan"),
    "compare": ('compare = ["D", "F"]', "design.compare[2]", "allowed: A, c, D"),
    "prior": ("prior = true", "design.prior", 'scaling = "tolerance"'),
    "polish": ('criterion = "G"\n' + KNOWN + "polish = { }", "design.polish", "no gradient"),
    "polish of nothing": ("polish = { free = { cap = {} } }", "design.polish.free.cap", "did you mean cup"),
    "polish unit": ("polish = { free = { cup = { length = [0, 1] } } }", "design.polish.free.cup.length", "length_mm"),
    "limits": ("limits = { joints = { q9_mm = { from = 0, to = 1 } } }", "design.limits.joints.q9_mm", "q1_mm"),
    "nothing moves": (
        "limits = { spheres = [{ at_mm = [0, 0, 0], radius_mm = 1 }] }",
        "design.limits",
        "links_mm, bar_mm or both",
    ),
    "no candidate": ("limits = { joints = { q1_mm = { from = 0, to = 1 } } }", "design.limits", "no candidate of cup"),
    "chance": ("limits = { travel_chance = 0.5 }", "design.limits.travel_chance", "give travel_mm"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_field_and_remedy(name):
    fields, field, words = REFUSED[name]
    with pytest.raises(InputError) as error:
        sample.resolved(text(fields + "\n"))
    assert error.value.field == field, str(error.value)
    assert words in str(error.value)


@pytest.mark.parametrize(("fields", "field", "words"), [
    ("readings = 4", "design.criterion", "cannot determine"),
    ("readings = 9", "design.criterion", "cannot choose 9"),
    (KNOWN + "budget_min = 5", "design.criterion", "raise the budget"),
    (KNOWN + "order = { reference_every_min = 0.1 }", "design.order.reference_every_min", "raise it"),
])  # fmt: skip
def test_a_plan_that_does_not_exist_is_refused(fields, field, words):
    with pytest.raises(InputError) as error:
        chosen(text(fields + "\n"))
    assert error.value.field == field, str(error.value)
    assert words in str(error.value)


def test_a_run_realises_what_it_predicts_and_names_the_widest_directions(tmp_path):
    """Terms of a direction are shares of a unit vector, per prior standard deviation."""
    path = tmp_path / "s.study.toml"
    tables = (
        "\n[readings]\nsimulate = true\n[posterior]\nsteps = 60\ness = 20\n"
        "[report]\nhtml = false\npdf = false\ncorner = 2\n[prediction]\nvirtual_machines = 10\n"
        'z_mm = 1146.0\npsi_deg = [0.0, 120.0]\ntheta_deg = 20.0\nreference = "home"\n'
    )
    path.write_text(sample.STUDY.partition("[report]")[0] + tables, encoding="utf-8")
    main(["run", str(path), "--out", str(tmp_path / "out")])
    result = load_result(tmp_path / "out")
    assert result.posterior is not None
    assert result.prediction.realised is not None
    for name in ("z", "psi", "theta"):
        predicted = result.prediction.components[name].after.rms
        assert 0.3 < result.prediction.realised[name].rms / predicted < 3.0
    for direction in result.posterior.directions:
        shares = np.array(direction.split()[::2], dtype=float)
        assert 0.3 < shares @ shares < 1.05


ROBUST = (
    'criterion = "I"\n' + small.KNOWN + 'robust = { risk = "worst", scenarios = 6 }\n'
)
MANY = (
    'criterion = "I"\n'
    + small.KNOWN
    + "how_many = { readings = [2, 4, 6], most = 8 }\n"
)


def best_accuracy(
    resolved: small.Resolved, design: small.Chosen, size: int
) -> dict[str, float]:
    """Least predicted rms of each component, SI, of all plans of `size` candidates, by
    plain linear algebra.
    """
    m, maps = resolved.measurement, design.criteria.error_maps
    whitened = small.rows(resolved)
    plans = np.array(list(itertools.combinations(range(len(whitened)), size)))
    rows = whitened[plans]
    information = np.eye(rows.shape[2]) + np.swapaxes(rows, 1, 2) @ rows
    every_slope = np.zeros((*maps.raw.shape[:2], len(m.names)))
    every_slope[:, :, : maps.raw.shape[2]] = maps.raw
    slopes = (every_slope * m.tolerance)[:, :, m.free]
    covariance = np.linalg.inv(information)
    products = np.einsum("nkp,nkq->kpq", slopes, slopes) / len(slopes)
    variance = np.einsum("kpq,cpq->ck", products, covariance).min(axis=0)
    return dict(zip(maps.names, np.sqrt(variance), strict=True))


def test_a_robust_plan_is_never_worse_than_the_nominal_one_and_below_its_bound():
    resolved, design = small.chosen(small.text(ROBUST))
    robust = design.robust
    assert len(robust.values) == 6
    assert robust.value == pytest.approx(min(robust.values))
    assert robust.nominal == pytest.approx(min(robust.nominal_values))
    assert robust.nominal - 1e-8 <= robust.value <= robust.bound
    # the first scenario is the nominal machine: log phi = -log of the summed variance
    # there
    rows = small.rows(resolved)[design.choice.indices]
    gradients = design.criteria.ingredient("I", resolved.measurement)
    wanted = gradients.reshape(-1, gradients.shape[2]) / np.sqrt(len(gradients))
    covariance = np.linalg.inv(np.eye(rows.shape[1]) + rows.T @ rows)
    assert robust.values[0] == pytest.approx(
        -np.log(np.trace(wanted @ covariance @ wanted.T)), abs=1e-9
    )
    assert (
        "6 machines drawn from the tolerances" in small.section(resolved, design).words
    )


def test_accuracy_against_the_number_of_readings():
    """No pair of readings is more accurate than the bound, and the curve falls."""
    resolved, design = small.chosen(small.text(MANY))
    curve = design.how_many
    assert curve.sizes == [2, 4, 6]
    pairs = best_accuracy(resolved, design, 2)
    for name, unit, key in (("x", 1e-6, "x_um"), ("z", 1e-6, "z_um")):
        best = pairs[name] / unit
        assert curve.bound[key][0] <= best * (1 + 1e-9)
        assert curve.accuracy[key][0] >= best * (1 - 1e-9)
        assert (np.diff(curve.bound[key]) < 0).all()
        assert curve.accuracy[key][2] < curve.accuracy[key][0]


@pytest.mark.slow
def test_the_fewest_readings_for_a_wanted_accuracy():
    resolved, design = small.chosen(small.text(MANY))
    best = {n: best_accuracy(resolved, design, n)["z"] for n in (3, 4)}
    wanted = 1e6 * 0.5 * (best[3] + best[4])  # four can, three cannot
    changed = MANY.replace("most = 8", f"most = 8, wanted = {{ z_um = {wanted:.6f} }}")
    _, design = small.chosen(small.text(changed))
    assert design.how_many.fewest == 4
    assert design.how_many.at_least <= 4
    _, unreachable = small.chosen(
        small.text(MANY.replace("most = 8", "most = 8, wanted = { z_um = 0.001 }"))
    )
    assert unreachable.how_many.fewest is None
    assert "no plan of that size can" in unreachable.how_many.words


@pytest.mark.parametrize(("design", "words"), [
    ("robust = {}\n", "not all drawn machines see"),
    ("how_many = {}\n", "accuracy depends on the tolerances"),
    ('criterion = "E"\n' + small.KNOWN + "robust = { scenarios = 2 }\n", "a smooth criterion"),
    (small.KNOWN + "how_many = { wanted = { w_um = 3 } }\n", "w_um"),
    (small.KNOWN + 'robust = { risk = "hope" }\n', "risk"),
])  # fmt: skip
def test_what_cannot_be_computed_is_refused(design, words):
    with pytest.raises(InputError, match=words):
        small.chosen(small.text(design))
