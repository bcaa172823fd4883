"""Forms over time and place on what carries them: against signatures of effects, and
found where they were planted.
"""

from __future__ import annotations

import numpy as np
import pytest

from kernel import gap_problem as case
from kernel.gap_lines import readings
from oed.effect import Column, Effect, State
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers, library, spots
from oed.gap.forms.processes.base import UNIT

PERIOD = 700.0


def _problem(name: str) -> GapProblem:
    """Lines read against their own beginning, or circles of a ball bar."""
    return readings(1) if name == "lines" else case.circles()


def _hum(state: State) -> list[Column]:
    wave = np.sin(2.0 * np.pi * state.time / PERIOD)
    parts = [Column(f"leg {i + 1}", UNIT, joints={i: wave}) for i in state.limbs]
    return [
        *parts,
        *(
            Column(f"tool {k}", UNIT, joints=state.displacing_joints(k, wave))
            for k in range(3)
        ),
    ]


@pytest.mark.parametrize("name", ["lines", "circles"])
def test_a_wave_on_a_joint_or_the_tool_is_what_an_effect_of_it_would_read(
    name: str,
) -> None:
    """At the pose read and at what it is read against, each at its own time."""
    problem = _problem(name)
    effect = Effect(
        name="hum", source="test", about="hum", columns=_hum, needs=("time",)
    )
    signature = problem.signature(effect, {})
    wanted = dict(
        zip(signature.names, problem.in_noise_units(signature.columns).T, strict=True)
    )
    form = carriers.at_poses(
        problem, [np.sin(2.0 * np.pi * s.time / PERIOD) for s in problem.states]
    )[..., None]
    *legs, tool = carriers.all_carriers(problem)[len(np.unique(problem.channel)) :]
    for i, leg in enumerate(legs):
        assert carriers.apply_carrier(leg, form)[:, 0, 0] == pytest.approx(
            wanted[f"leg {i + 1}"], abs=1e-9
        )
    for k in range(3):
        change = carriers.apply_carrier(tool, form)[:, k, 0]
        assert change == pytest.approx(
            wanted.get(f"tool {k}", np.zeros(len(problem))), abs=1e-5
        )


def test_what_a_form_explains_is_that_of_least_squares(
    rng: np.random.Generator,
) -> None:
    problem = case.circles()
    law = case.law(problem)
    metric, covariance = Metric(problem, law), case.dense(problem, law)
    forms, r = (
        rng.standard_normal((len(problem), 2, 3)),
        2.0 * rng.standard_normal(len(problem)),
    )
    tails = carriers.log_tails(metric, forms, metric.parts(r[:, None]))
    for k in range(3):
        inverse, G = np.linalg.inv(covariance), forms[:, :, k]
        energy = r @ inverse @ G @ np.linalg.solve(G.T @ inverse @ G, G.T @ inverse @ r)
        assert tails[k] == pytest.approx(
            -0.5 * energy, rel=1e-3
        )  # of two degrees of freedom


def _planted(size: float) -> tuple[GapProblem, np.ndarray]:
    """Circles with a bump in the tool's place, along x, about the place of reading 40;
    and that place.
    """
    problem = case.circles()
    law = case.law(problem)
    covariance = case.dense(problem, law)
    at = carriers.at_poses(problem, [s.tool for s in problem.states])
    reach = np.ptp(at[:, 0], axis=0).max()
    away = ((at - at[40, 0]) ** 2).sum(axis=2)
    bump = carriers.apply_carrier(
        carriers.all_carriers(problem)[-1],
        np.exp(-0.5 * away / (0.17 * reach) ** 2)[..., None],
    )[:, 0, 0]
    noise = np.linalg.cholesky(covariance) @ np.random.default_rng(5).standard_normal(
        len(problem)
    )
    return (
        problem.with_residual(noise + case.sized(bump, covariance, size)),
        at[40, 0] / reach,
    )


def test_a_fault_at_a_place_is_found_there() -> None:
    problem, place = _planted(10.0)
    law = case.law(problem)
    empty = library.build(problem, ())
    processes = spots.add(empty, problem, law)
    assert len(processes.atoms) == spots.BEST
    assert {a.effect for a in processes.atoms} == {spots.NAME}
    best = processes.atoms[0]
    assert (
        np.linalg.norm(
            [best.constants[k] - c for k, c in zip("xyz", place, strict=True)]
        )
        < 0.12
    )
    assert best.constants["width"] in (0.12, 0.17, 0.24)
    looked = np.exp(
        -best.log_weight
    )  # one of so many: places, widths, a channel, three legs and the tool
    assert 100.0 < looked <= spots.PLACES * len(spots.WIDTHS) * 5
    r = problem.residual
    G = processes.columns[:, best.columns]
    inverse = np.linalg.inv(case.dense(problem, law))
    explained = r @ inverse @ G @ np.linalg.solve(G.T @ inverse @ G, G.T @ inverse @ r)
    assert explained > 70.0
