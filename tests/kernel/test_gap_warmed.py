"""When a tool was warmed: lengths against an integrated heat balance, stretches against
those that were planted.
"""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy import integrate

from kernel import gap_problem as case
from kernel.gap_problem import Machines
from oed.gap.data.metric import Embedding
from oed.gap.data.problem import GapProblem
from oed.gap.place import session, warm_up
from oed.gap.place.locate import locate

#: a session of seven hours
SLOWLY = 30.0
TAU = 1200.0


@pytest.fixture(scope="module")
def machines() -> Machines:
    problem = case.circles()
    rows = problem.rows.assign(time=SLOWLY * problem.rows["time"])
    states = tuple(
        dataclasses.replace(
            s,
            time=SLOWLY * s.time,
            session_span=tuple(SLOWLY * v for v in s.session_span),
        )
        for s in problem.states
    )
    slow = dataclasses.replace(problem, rows=rows, states=states)
    return Machines(slow, case.law(slow))


def length(
    time: np.ndarray, stretches: list[tuple[float, float]], tau: float = TAU
) -> np.ndarray:
    """Length of a tool that is warmed in some stretches, from its heat balance tau
    dL/dt = q - L, step by step.
    """
    lengths, ends = (
        np.zeros(len(time)),
        sorted({0.0, float(time.max()) + 1.0, *np.ravel(stretches)}),
    )
    last = 0.0
    for a, b in itertools.pairwise(ends):
        on = float(any(p <= a < q for p, q in stretches))
        inside = (time >= a) & (time < b)
        at, places = np.unique(np.append(time[inside], b), return_inverse=True)
        solution = integrate.solve_ivp(
            lambda _, x, q=on: (q - x) / tau,
            (a, b),
            [last],
            t_eval=at,
            rtol=1e-8,
            atol=1e-10,
        )
        lengths[inside], last = solution.y[0][places[:-1]], float(solution.y[0][-1])
    return lengths


def grown(problem: GapProblem, share: np.ndarray) -> np.ndarray:
    """Change (N,) of the readings where the tool is longer by a share (m,) of a
    micrometre.
    """
    state = problem.states[0]
    return np.sum(
        [
            case.in_joint(problem, i, 1e-6 * share * state.joints_per_extension[:, i])
            for i in state.limbs
        ],
        axis=0,
    )


def located_times(
    problem: GapProblem, law, seed: int, *, known: bool = False
) -> list[tuple[float, float]]:
    blocks = locate(problem, law, np.random.default_rng(seed), draws=100, known=known)
    return [
        tuple(float(v) for v in b.block.removeprefix("time ").split("-"))
        for b in blocks
        if b.block.startswith("time")
    ]


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    both = max(0.0, min(one[1], other[1]) - max(one[0], other[0]))
    return both / (one[1] - one[0] + other[1] - other[0] - both)


def test_length_is_that_of_the_heat_balance(rng: np.random.Generator) -> None:
    time = np.sort(rng.uniform(0.0, 20e3, 60))
    stretches = [(2e3, 5e3), (11e3, 11.5e3), (11e3, 25e3)]
    lengths = warm_up.response(time, *np.array(stretches).T, TAU)
    for column, stretch in zip(lengths.T, stretches, strict=True):
        np.testing.assert_allclose(column, length(time, [stretch]), atol=1e-6)
    assert np.all(
        warm_up.response(np.array([np.nan]), np.zeros(1), np.ones(1), TAU) == 0.0
    )


def test_readings_of_a_longer_tool_are_those_of_its_joints(
    machines: Machines, rng: np.random.Generator
) -> None:
    problem = machines.problem
    share = rng.uniform(size=(len(problem.states[0]), 2))
    change = session.tool_growth(problem, [share])
    for k in range(2):
        np.testing.assert_allclose(change[:, k], grown(problem, share[:, k]), atol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_stretches_of_heat_are_found_where_the_tool_is_long_for_longer(
    machines: Machines, sign: float
) -> None:
    stretches = [(3e3, 6e3), (14e3, 17e3)]
    change = sign * grown(
        machines.problem, length(machines.problem.states[0].time, stretches)
    )
    right, plainly = 0, 0
    for seed in range(8):
        noise = machines.root @ np.random.default_rng(seed).standard_normal(
            len(machines.problem)
        )
        problem = machines.problem.with_residual(
            noise + case.sized(change, machines.covariance, 15.0)
        )
        right += (
            max(
                overlap(located_times(problem, machines.law, seed)[0], s)
                for s in stretches
            )
            > 0.4
        )
        plainly += (
            max(
                overlap(located_times(problem, machines.law, seed, known=True)[0], s)
                for s in stretches
            )
            > 0.4
        )
    assert right >= 6
    assert right > plainly


def test_what_shifts_at_once_is_no_heat(machines: Machines) -> None:
    """A tool that is longer from one reading to another: heat explains no more than the
    window.
    """
    time = machines.problem.states[0].time
    change = grown(machines.problem, ((time >= 8e3) & (time < 16e3)).astype(float))
    ends = []
    for seed in range(4):
        noise = machines.root @ np.random.default_rng(seed).standard_normal(
            len(machines.problem)
        )
        problem = machines.problem.with_residual(
            noise + case.sized(change, machines.covariance, 15.0)
        )
        ends.append(located_times(problem, machines.law, seed)[0])
    assert np.median([overlap(e, (8e3, 16e3)) for e in ends]) > 0.9


def test_nothing_is_warm_where_no_tool_can_be_seen(machines: Machines) -> None:
    problem = machines.problem.with_residual(np.zeros(len(machines.problem)))
    root = Embedding(problem, machines.law)
    assert warm_up.intervals(problem, root.scores, 0.0) == []
