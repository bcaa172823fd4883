"""Weights in a study: D, A and E by each solver, against cvxpy's own atoms; refusals."""

import sys

import pytest
from design_sample import KNOWN, chosen, text

from pkm_studies import stages, study
from pkm_studies.base import InputError


@pytest.mark.parametrize("solver", ["built_in", "clarabel"])
def test_a_study_with_weights_runs(solver, tmp_path):
    """Weights are the kernel's (tests/oed/design/test_relaxation.py); the largest are read."""
    path = tmp_path / "weights.study.toml"
    fields = f'criterion = "D"\nmethod = "relaxed"\nsolver = "{solver}"\n'
    path.write_text(text(fields + KNOWN))
    result = stages.run_study(study.Study.load(path), tmp_path / "out")
    design = result.design
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
