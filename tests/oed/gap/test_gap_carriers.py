"""Forms over time and place on what carries them, against signatures of effects."""

import numpy as np
import pytest

from kernel import gap_problem as case
from kernel.gap_lines import readings
from oed.effect_model import Column, Effect, State
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import discrepancy, waves

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
