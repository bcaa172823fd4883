"""Quotas, branch and bound and weights in a study: plans, certificates, refusals."""

import itertools
import sys

import numpy as np
import pytest
from design_sample import (
    EXTRA,
    GRID,
    GRIDS,
    KNOWN,
    THREE,
    chosen,
    rows,
    section,
    text,
    value,
)

from pkm_studies import stages, study
from pkm_studies.base import InputError
from pkm_studies.resolve import ResolvedStudy

HIGH = """
[[design.quota]]
name = "high"
z_mm = { from = 1200 }
"""


def heights(resolved: ResolvedStudy) -> np.ndarray:
    """Commanded heights (C,) of the candidates, m."""
    return np.concatenate([s.reading_commands()[:, 0] for s in resolved.candidates])


# -- quotas ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "numbers"), [("D", "min_share = 1.0"), ("I", "max = 1")]
)
def test_the_best_plan_under_a_quota(name, numbers):
    """At most one or all three readings above z = 1.2 m; tests/oed/design has all criteria."""
    tables = GRID.format(name="cup") + HIGH + numbers + "\n"
    resolved, design = chosen(
        text(f'criterion = "{name}"\n' + KNOWN + EXTRA, tables=tables)
    )
    high = heights(resolved) > 1.2
    allowed = {"max = 1": (0, 1), "min_share = 1.0": (3,)}[numbers]
    h = rows(resolved)
    values = [
        value(name, h[list(plan)], resolved)
        for plan in itertools.combinations(range(8), 3)
        if high[list(plan)].sum() in allowed
    ]
    indices = design.choice.indices
    assert high[indices].sum() in allowed
    best, size = max(values), abs(max(values))
    assert value(name, h[indices], resolved) == pytest.approx(best, abs=2e-5 * size)
    made = section(resolved, design)
    assert made.bound >= best - 1e-5 * size
    assert made.efficiency is not None


def test_equal_numbers_a_setup():
    resolved, design = chosen(
        text('equal = "setup"\n' + KNOWN, tables=GRIDS, setups=THREE, workspace="")
    )
    assert [len(s) for s in design.series] == [1, 1, 1]
    free = chosen(text(KNOWN, tables=GRIDS, setups=THREE, workspace=""))[1]
    assert design.choice.value <= free.choice.value * (1.0 + 1e-9)
    assert design.choice.value <= design.choice.bound
    names = {s.setup for s in design.series}
    assert names == {"low", "high", "side"}
    assert section(resolved, design).n == 3


def test_runs_and_setups_select_candidates():
    """Runs at two heights: two readings of the lower one, by its label."""
    tables = GRID.format(name="cup") + 'runs_by = "z"\n'
    tables += (
        '[[design.quota]]\nruns = ["z=1086*"]\nsetups = ["cup"]\nmin = 2\nmax = 2\n'
    )
    resolved, design = chosen(text(KNOWN, tables=tables))
    low = heights(resolved) < 1.2
    assert low[design.choice.indices].sum() == 2


def test_whole_runs_are_counted_as_one():
    """Two of four circles, at most one of the upper two."""
    grid = GRID.format(name="cup").replace("[1086, 1246]", "[1086, 1146, 1206, 1246]")
    tables = grid + 'runs_by = "z"\n' + HIGH + "max = 1\n"
    plan = KNOWN.replace("readings = 3", "readings = 2\nwhole_runs = true")
    resolved, design = chosen(text(plan, tables=tables))
    chosen_runs = {run for s in design.series for run in s.run}
    assert len(chosen_runs) == 2
    assert len(chosen_runs & {"z=1206mm", "z=1246mm"}) <= 1
    assert len(heights(resolved)) == 16


def test_a_study_with_quotas_runs_end_to_end(tmp_path):
    """The command's result: poses keep the quota, the certificate is against its bound."""
    file = tmp_path / "quota.study.toml"
    tables = GRID.format(name="cup") + HIGH + "max = 1\n"
    file.write_text(text(KNOWN, tables=tables), encoding="utf-8")
    loaded = study.Study.load(file)
    design = stages.run_study(loaded, tmp_path / "out", report=False).design
    above = [pose for pose in design.poses if pose.command["z_mm"] > 1200.0]
    assert len(design.poses) == 3
    assert len(above) <= 1
    assert design.bound >= design.value
    assert 0.0 < design.efficiency <= 1.0


CONTRADICTION = (
    HIGH + 'min = 2\n[[design.quota]]\nname = "few"\nmax = 1\nz_mm = { from = 1100 }\n'
)


@pytest.mark.parametrize(("design", "quotas", "message"), [
    (KNOWN, CONTRADICTION,
     r'design.quota\[1\]: at least 2 of "high" \(4 candidates\) and at most 1 of "few" '
     r"\(4 candidates\) of 3 readings contradict each other; relax one"),
    (KNOWN.replace("3", "7"), HIGH + "max = 2\n",
     r"design.quota\[1\]: with 7 readings to choose, the candidates do not allow "
     r'at most 2 of "high" \(4 candidates\); change its numbers'),
    (KNOWN.replace("3", "9"), HIGH + "max = 4\n", "design.readings = 9: there are only 8"),
    (KNOWN, HIGH, r"design.quota\[1\]: how many readings\?; give min, max"),
    (KNOWN, HIGH + "max = 1\nmax_share = 0.5\n", "max_share = 0.5: max is given"),
    (KNOWN, HIGH + "min = 2\nmax = 1\n", "min = 2: more than the largest number, 1"),
    (KNOWN, HIGH.replace("1200", "1300") + "max = 1\n", "no candidate is selected"),
    (KNOWN, HIGH.replace("from = 1200", "") + "max = 1\n", "the range has no end"),
    (KNOWN, HIGH.replace("z_mm", "w_mm") + "max = 1\n", "w_mm: unknown field"),
    (KNOWN, HIGH + 'max = 1\nruns = ["two"]\n', "no run has this name"),
    (KNOWN, HIGH + 'max = 1\nsetups = ["cap"]\n', "no such set-up"),
    (KNOWN.replace("readings = 3", "budget_min = 60"), HIGH + "max = 1\n",
     "budget_min = 60: quota needs the number of readings"),
    (KNOWN + "setups_max = 1\n", HIGH + "max = 1\n", "remove setups_max"),
    (KNOWN + "polish = {}\n", HIGH + "max = 1\n", "out of the ranges of a quota"),
    (KNOWN + "how_many = {}\n", HIGH + "max = 1\n", "remove quota or how_many"),
    (KNOWN + 'equal = "run"\n', HIGH + "max = 1\n", ""),
])  # fmt: skip
def test_impossible_quotas_are_refused(design, quotas, message):
    tables = GRID.format(name="cup") + quotas
    if not message:  # one run: equal numbers are no rule
        assert chosen(text(design, tables=tables))
        return
    with pytest.raises(InputError, match=message):
        chosen(text(design, tables=tables))


def test_readings_that_cannot_be_shared_equally_are_refused():
    plan = KNOWN.replace("3", "4") + 'equal = "setup"\n'
    with pytest.raises(
        InputError, match=r'equal = "setup": 4 cannot .* ask for 3 or 6'
    ):
        chosen(text(plan, tables=GRIDS, setups=THREE, workspace=""))


# -- branch and bound ------------------------------------------------------------------
@pytest.mark.parametrize("name", ["D", "O5"])
def test_branching_proves_the_best_plan(name):
    resolved, design = chosen(
        text(f'criterion = "{name}"\nbranch_nodes = 500\n' + KNOWN + EXTRA)
    )
    h = rows(resolved)
    plans = itertools.combinations(range(8), 3)
    best = max(value(name, h[list(plan)], resolved) for plan in plans)
    made = section(resolved, design)
    assert made.proven
    assert made.efficiency == pytest.approx(1.0, abs=1e-6)
    assert made.bound == pytest.approx(best, abs=1e-5 * abs(best))
    assert made.words.startswith("Proven optimal")


@pytest.mark.parametrize(("design", "tables", "message"), [
    ('criterion = "E"\n', "", "branch_nodes = 5: branch and bound needs a smooth"),
    ("apart = { z_mm = 10 }\n", "", "does not know the rule apart"),
    ("", HIGH + "max = 1\n", "leave branch_nodes or quota out"),
    ("robust = {}\n", "", "does not know the rule robust"),
])  # fmt: skip
def test_branching_is_refused_where_it_does_not_apply(design, tables, message):
    plan = design + "branch_nodes = 5\n" + KNOWN
    with pytest.raises(InputError, match=message):
        chosen(text(plan, tables=GRID.format(name="cup") + tables))


@pytest.mark.parametrize("solver", ["built_in", "clarabel"])
def test_a_study_with_weights_runs(solver, tmp_path):
    """Weights are the kernel's (tests/oed/design/test_relaxation.py); the largest are read."""
    path = tmp_path / "weights.study.toml"
    fields = f'criterion = "D"\nmethod = "relaxed"\nsolver = "{solver}"\n'
    path.write_text(text(fields + KNOWN))
    loaded = study.Study.load(path)
    design = stages.run_study(loaded, tmp_path / "out", report=False).design
    assert design.relaxed.weights
    assert design.n == 3
    assert "largest of the relaxation's weights" in design.words


@pytest.mark.parametrize(("design", "field", "words"), [
    ('method = "relaxed"\ncriterion = "kappa"\n', "method", "not kappa"),
    ('method = "relaxed"\nbranch_nodes = 5\n', "method", "branch_nodes"),
    ('method = "relaxed"\nequal = "setup"\n', "method", "equal"),
    ('method = "relaxed"\ncompare = ["A"]\n', "method", "compare"),
    ('solver = "scs"\n', "solver", 'method = "relaxed"'),
])  # fmt: skip
def test_what_weights_do_not_go_with_is_refused(design, field, words):
    with pytest.raises(InputError) as error:
        chosen(text(design + KNOWN))
    assert f"design.{field}" in str(error.value)
    assert words in str(error.value)


def test_a_solver_that_is_not_installed_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "scs", None)
    with pytest.raises(InputError, match=r"pip install pkm-oed\[scs\]"):
        chosen(text('method = "relaxed"\nsolver = "scs"\n' + KNOWN))
