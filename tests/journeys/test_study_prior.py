"""`[[prior.correlated]]` of a study: what it changes, what is refused."""

import json

import numpy as np
import pytest
import sample

from pkm_studies.commands import main

LEGS = '[[prior.correlated]]\nparameters = ["dq*"]\ncorrelation = 0.9\n\n'


def prior(lines: str) -> str:
    return sample.changed(sample.STUDY, ("[design]", lines + "[design]"))


def test_legs_of_one_batch_are_correlated():
    resolved = sample.resolved(prior(LEGS))
    m = resolved.measurement_with(resolved.setups)
    covariance = m.prior_covariance
    legs = [m.names.index(f"dq{k}") for k in (1, 2, 3)]
    block = covariance[np.ix_(legs, legs)] / m.tolerance[legs[0]] ** 2
    assert block == pytest.approx(0.1 * np.eye(3) + 0.9)
    others = [k for k in range(len(covariance)) if k not in legs]
    assert not covariance[np.ix_(legs, others)].any()


def test_later_tables_win():
    pair = LEGS.replace('"dq*"', '"dq1", "dq2"').replace("0.9", "0.5")
    resolved = sample.resolved(prior(LEGS.replace("0.9", "0.6") + pair))
    m = resolved.measurement_with(resolved.setups)
    first, second, third = (m.names.index(f"dq{k}") for k in (1, 2, 3))
    assert m.correlation[first, second] == 0.5
    assert m.correlation[first, third] == 0.6


REFUSED = {
    LEGS.replace("0.9", "1.0"): "correlation = 1",
    LEGS.replace("0.9", "-0.6"): "no errors have such correlations",
    LEGS.replace('"dq*"', '"dr*"'): "no parameter has this name",
    LEGS.replace('"dq*"', '"dq1"'): "fewer than two parameters",
    LEGS.replace('"dq*"', '"cup.*"'): "no parameter has this name",
}


@pytest.mark.parametrize("lines", list(REFUSED))
def test_what_cannot_be_is_refused(lines):
    error = sample.refused(prior(lines))
    assert error.field.startswith("prior.correlated[1]")
    assert REFUSED[lines] in str(error)


def test_a_design_for_correlated_legs_counts_them_once(tmp_path):
    """Legs of one batch are known better before, so that readings gain less."""
    options = "[readings]\nsimulate = true\n[posterior]\nenabled = false\n[expect]"
    gains = {}
    for name, lines in (("independent", ""), ("batch", LEGS)):
        text = sample.changed(
            prior(lines),
            ('criterion = "D"', 'criterion = "D"\nscaling = "tolerance"\nprior = true'),
            ("[expect]", options),
        )
        path = tmp_path / f"{name}.study.toml"
        path.write_text(text, encoding="utf-8")
        out = tmp_path / name
        assert main(["run", str(path), "--quiet", "--out", str(out)]) == 0
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
        (chosen,) = [p for p in result["design"]["plans"] if p["name"] == "chosen"]
        gains[name] = chosen["logdet"], chosen["value"]
    # of P, with eigenvalues 1 - 0.9 twice and 1 + 2 * 0.9
    known = -np.log(0.1 * 0.1 * 2.8)
    for name, prior_alone in (("independent", 0.0), ("batch", known)):
        gain, value = gains[name]
        assert gain == pytest.approx(value - prior_alone, rel=1e-6)
    assert gains["batch"][0] < gains["independent"][0] - 1.0


BOUNDS = '[[prior.bounds]]\nparameters = ["dq1"]\nlower_mm = 0.0\nupper_mm = 2.0\n\n'


def test_bounds_are_of_the_value():
    resolved = sample.resolved(prior(BOUNDS))
    m = resolved.measurement_with(resolved.setups)
    first = m.names.index("dq1")
    assert m.bounds[first] == pytest.approx([0.0, 2e-3])
    assert list(m.bounded) == [first]


BOUNDS_REFUSED = {
    BOUNDS.replace("upper_mm", "upper"): "the unit is missing",
    BOUNDS.replace("upper_mm", "upper_deg"): "no unit for upper",
    BOUNDS.replace("lower_mm = 0.0", "lower_mm = 1.0"): "is not within",
    BOUNDS.replace("lower_mm = 0.0\nupper_mm = 2.0\n", ""): "give lower, upper, or both",
    BOUNDS.replace("2.0", "0.01"): "of the machines of the tolerances keep",
    BOUNDS.replace('"dq1"', '"dq*", "beta*"'): "parameters of different kinds",
}  # fmt: skip


@pytest.mark.parametrize("lines", list(BOUNDS_REFUSED))
def test_bounds_that_cannot_be_are_refused(lines):
    error = sample.refused(prior(lines))
    assert error.field.startswith("prior.bounds")
    assert BOUNDS_REFUSED[lines] in str(error)
