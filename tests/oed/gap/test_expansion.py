"""Points about which effects act, and forms on what carries them, against dense matrices."""

import functools

import numpy as np
import pytest

from kernel import gap_problem as case
from kernel.gap_lines import BOW, EFFECTS, planted, readings, search_of, white_lines
from kernel.laws import STATED_LAW, noise_covariance, residual_covariance
from oed.effect_model import Column, Effect, State
from oed.gap.cause.compare import compare, compare_expanded
from oed.gap.cause.search import Search
from oed.gap.data.linearisation import ActingEffectForm, settle
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import discrepancy, waves
from oed.gap.procedure import explain

FORM = ActingEffectForm(BOW, {"turns": 3.0}, ("leg 1", "leg 2"), 3.0)


@functools.cache
def bowed() -> GapProblem:
    """Lines of a machine whose first leg is bowed by four expected sizes."""
    return planted(white_lines(), BOW, {"leg 1": 4.0}, turns=3.0)


def test_small_effects_settle_at_the_linear_estimate():
    """In expected sizes: the mean of coefficients of prior N(0, 1) times the form's."""
    problem = bowed()
    law, none = STATED_LAW, np.zeros(len(problem))
    settled = settle(problem, [FORM], law, none)
    signature = problem.signature(BOW, FORM.constants)
    rows = [signature.names.index(name) for name in FORM.names]
    columns = FORM.size * problem.noise_units(signature.columns[:, rows])
    weighed = np.linalg.solve(residual_covariance(problem, STATED_LAW), columns)
    precision = columns.T @ weighed + np.eye(2)
    exact = FORM.size * np.linalg.solve(precision, weighed.T @ problem.residual)
    assert settled.coefficients == pytest.approx(exact, abs=0.02)
    assert settled.coefficients[0] == pytest.approx(4.0, abs=0.5)
    assert settled.departure < 0.3
    assert settled.problem.residual == pytest.approx(problem.residual, abs=0.3)


@functools.cache
def searched() -> Search:
    return search_of(bowed())


def test_small_effects_ask_for_no_other_point():
    comparison = compare_expanded(bowed(), EFFECTS, lambda p: [search_of(p)])
    assert len(comparison.searches) == 1
    plain = compare([searched()])
    assert [h.key for h in comparison.hypotheses] == [h.key for h in plain]
    assert comparison.hypotheses[0].effects == ("bow",)


def test_parts_of_the_residual_are_the_dense_estimates():
    problem, search = bowed(), searched()
    best = next(h for h in compare([search]) if h.key == (frozenset({"bow"}), False))
    parts, sigma = explain(problem, search, best, {"bow"}), problem.sigma
    columns = search.library.scaled_columns(best.atoms[0], best.sizes[0])
    weighed = np.linalg.solve(residual_covariance(problem, STATED_LAW), columns)
    precision = columns.T @ weighed + np.eye(columns.shape[1])
    mean = np.linalg.solve(precision, weighed.T @ problem.residual)
    explained = parts.explained / sigma
    assert explained == pytest.approx(columns @ mean, abs=1e-6)
    assert parts.unexplained == pytest.approx(0.0, abs=1e-9)
    noise = noise_covariance(problem, STATED_LAW)
    # what parameters leave of r is R (R + H H^T)^-1 r
    left = noise @ np.linalg.inv(residual_covariance(problem, STATED_LAW))
    assert parts.before / sigma == pytest.approx(left @ problem.residual, abs=1e-6)
    corrected = problem.residual - columns @ mean
    assert parts.after / sigma == pytest.approx(left @ corrected, abs=1e-6)
    (size,) = parts.sizes
    energy = explained @ np.linalg.solve(
        residual_covariance(problem, STATED_LAW), explained
    )
    level = search.noise_level(best)
    assert size.detectability == pytest.approx(np.sqrt(energy) / level)
    channel = problem.rows["channel"].to_numpy()
    for name, rms in size.rms.items():
        values = parts.explained[channel == name]
        assert rms == pytest.approx(np.sqrt(np.mean(values**2)))


def test_effects_that_are_not_named_count_as_unknown():
    problem, search = bowed(), searched()
    best = next(h for h in compare([search]) if h.key == (frozenset({"bow"}), False))
    named, unnamed = (explain(problem, search, best, n) for n in ({"bow"}, set()))
    assert unnamed.coefficients == ()
    assert unnamed.explained == pytest.approx(0.0)
    assert unnamed.unexplained == pytest.approx(named.explained)


PERIOD, SIZE = 700.0, 1e-6


def _problem(name: str) -> GapProblem:
    """Lines read against their own beginning, or circles of a ball bar."""
    return readings(1) if name == "lines" else case.circles()


def _hum(state: State) -> list[Column]:
    wave = np.sin(2.0 * np.pi * state.time / PERIOD)
    moved = {f"leg {i + 1}": {i: wave} for i in state.limbs}
    moved |= {f"tool {k}": state.displacing_joints(k, wave) for k in range(3)}
    moved["longer"] = {i: state.joints_per_extension[:, i] * wave for i in state.limbs}
    return [Column(name, SIZE, joints=joints) for name, joints in moved.items()]


@pytest.mark.parametrize("name", ["lines", "circles"])
def test_a_wave_on_a_joint_or_the_tool_is_what_an_effect_of_it_would_read(name):
    """At the pose read and at what it is read against, each at its own time."""
    problem = _problem(name)
    effect = Effect(
        name="hum", source="test", about="hum", columns=_hum, needs=("time",)
    )
    signature = problem.signature(effect, {})
    wanted = dict(
        zip(signature.names, problem.noise_units(signature.columns).T, strict=True)
    )
    form = discrepancy.values_of_poses(
        problem, [np.sin(2.0 * np.pi * s.time / PERIOD) for s in problem.states]
    )[..., None]
    _, joints, tool, tool_length = discrepancy.carriers_of(problem)
    legs, tools = (
        [f"leg {i + 1}" for i in problem.states[0].limbs],
        [f"tool {k}" for k in range(3)],
    )
    pairs = [(joints, legs), (tool, tools), (tool_length, ["longer"])]
    zeros = np.zeros(len(problem))
    for carrier, columns in pairs:
        change = discrepancy.apply_carrier(carrier.columns, form)[:, :, 0]
        expected = np.column_stack([wanted.get(name, zeros) for name in columns])
        assert np.sqrt((carrier.columns**2).sum(axis=2).mean()) == (pytest.approx(1.0))
        size = np.linalg.norm(expected) / np.linalg.norm(change)
        assert size * change == pytest.approx(expected, abs=1e-6 * np.ptp(expected))


def test_readings_are_carried_by_set_up_and_channel():
    problem = readings(1)
    each = discrepancy.readings(problem)
    assert each.labels == ("channel dy in lines", "channel dz in lines")
    assert (each.columns.sum(axis=(1, 2)) == 1.0).all()
    assert [
        part.name for part in discrepancy.readings(problem, by_setup=False).parts()
    ] == ["the readings of dy", "the readings of dz"]
    _, _, tool, _ = discrepancy.carriers_of(problem)
    assert len(tool.parts()) == 1


@pytest.mark.parametrize("count", [3, 40])
def test_what_a_wave_explains_is_that_of_least_squares(rng, count):
    problem = case.circles()
    law = case.law(problem)
    r, f = 2.0 * rng.standard_normal(len(problem)), np.linspace(0.1, 0.4, count)
    problem, covariance = problem.with_residual(r), case.dense(problem, law)
    clock, columns = rng.uniform(0.0, 60.0, (2, len(problem), 2))
    carrier = discrepancy.Carrier("", columns[:, None], ("",))
    precision = waves.WavePrecision(problem, Metric(problem, law))
    (tails,) = precision.log_tails(waves.Band("", "s", clock, (carrier,), f))
    wave = columns[:, :, None] * np.exp(2j * np.pi * clock[:, :, None] * f)
    inverse = np.linalg.inv(covariance)
    for tail, column in zip(tails, wave.sum(axis=1).T, strict=True):
        G = np.column_stack([column.real, column.imag])
        energy = r @ inverse @ G @ np.linalg.solve(G.T @ inverse @ G, G.T @ inverse @ r)
        # of two degrees of freedom
        assert tail == pytest.approx(-0.5 * energy, rel=1e-3)
