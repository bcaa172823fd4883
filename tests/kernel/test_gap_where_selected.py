"""Where an effect that was selected acts: its own columns as looks, and legs told by
their coefficients.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from kernel import gap_problem as case
from kernel.gap_problem import Machines, first
from oed.gap.data.metric import Embedding
from oed.gap.data.tail import log_tail
from oed.gap.place import scan
from oed.gap.place.effect_legs import effect_legs
from oed.gap.place.family import all_regions
from oed.gap.place.locate import locate
from oed.gap.place.scan import Scan

LEGS = ["leg 1", "leg 2", "leg 3"]


@pytest.fixture(scope="module")
def machines() -> Machines:
    problem = case.circles()
    return Machines(problem, case.law(problem))


def test_where_a_known_effect_acts_is_a_question_of_its_own(machines: Machines) -> None:
    """Its legs are corrected for one another, not for all that could be looked at."""
    rng, problem = np.random.default_rng(26), machines.problem
    odd = rng.standard_normal(len(problem.states[0].time))
    columns = np.column_stack([case.in_joint(problem, k, 1e-6 * odd) for k in range(3)])
    r = machines.root @ rng.standard_normal(len(problem)) + case.sized(
        columns[:, 1], machines.covariance, 3.5
    )
    here, p_values = problem.with_residual(r), {}
    for known in (True, False):
        blocks = locate(
            here,
            machines.law,
            np.random.default_rng(27),
            columns=columns,
            labels=LEGS,
            known=known,
        )
        p_values[known] = next(b.p_value for b in blocks if b.block == "leg 2")
    assert p_values[True] < 0.01
    assert p_values[False] > 5.0 * p_values[True]


def test_legs_of_a_known_effect_that_does_not_act_are_rarely_told(
    machines: Machines,
) -> None:
    rng, problem = np.random.default_rng(28), machines.problem
    columns = np.column_stack(
        [
            case.in_joint(
                problem, k, 1e-6 * rng.standard_normal(len(problem.states[0].time))
            )
            for k in range(3)
        ]
    )
    root = Embedding(problem, machines.law)
    looks = list(all_regions(problem, columns, LEGS, known=True))
    by_effect = np.array([look.known for look in looks])
    assert {look.place for look in looks if look.known and look.kind == "leg"} == set(
        LEGS
    )
    drawn = rng.standard_normal((len(problem), 500))
    quiet = root.scores(machines.root @ rng.standard_normal((len(problem), 400)))
    family = Scan(root, looks, np.hstack([drawn, quiet]))
    drawn, quiet = np.split(family.energy, [500], axis=1)
    least = family.log_least(drawn, by_effect)
    least_p = [
        scan._against_least(log_tail(e[by_effect], family.rank[by_effect]), least).min()
        for e in quiet.T
    ]
    assert (
        6 <= np.sum(np.array(least_p) <= 0.05) <= 36
    )  # 20 expected, both samplings' spread three times over


def test_selected_effects_own_columns_are_one_more_look(
    machines: Machines, rng: np.random.Generator
) -> None:
    problem = machines.problem
    odd = rng.standard_normal(
        len(problem.states[0].time)
    )  # a form that no general basis has
    columns = np.column_stack([case.in_joint(problem, k, 1e-6 * odd) for k in range(3)])
    r = machines.root @ rng.standard_normal(len(problem)) + case.sized(
        columns[:, 1], machines.covariance, 7.0
    )
    labels = ["leg 1", "leg 2", "leg 3"]
    blocks = locate(
        problem.with_residual(r), machines.law, rng, columns=columns, labels=labels
    )
    assert (blocks[0].block, blocks[0].p_value < 1e-3) == ("leg 2", True)
    blind = locate(problem.with_residual(r), machines.law, rng)
    assert min(b.p_value for b in blind) > blocks[0].p_value
    with pytest.raises(ValueError, match=r"\(144, 2\) fits the labels"):
        locate(problem, machines.law, rng, columns=columns, labels=labels[:2])


def test_legs_of_a_known_effect_are_told_by_its_own_columns_alone(
    machines: Machines,
) -> None:
    """A leg without a column of the effect is not told, nor are all; where more acts
    than the effect, they are.
    """
    rng, problem = np.random.default_rng(21), machines.problem
    odd = rng.standard_normal(len(problem.states[0].time))
    columns = np.column_stack([case.in_joint(problem, k, 1e-6 * odd) for k in (1, 2)])
    r = machines.root @ rng.standard_normal(len(problem)) + case.sized(
        columns[:, 0], machines.covariance, 7.0
    )
    here = problem.with_residual(r)

    def legs(labels: list[str], known: bool) -> list[str]:
        blocks = locate(
            here,
            machines.law,
            np.random.default_rng(22),
            columns=columns,
            labels=labels,
            known=known,
        )
        return [b.block for b in blocks if "leg" in b.block]

    assert legs(["leg 2", "leg 3"], True) == ["leg 2", "leg 3"]
    assert set(legs(["leg 2", "leg 3"], False)) >= {"leg 1", "leg 2", "leg 3"}
    assert set(legs(["leg 2", ""], True)) >= {"leg 1", "leg 2", "leg 3"}


def test_an_effects_own_columns_tell_its_leg_where_general_looks_mistake_it(
    machines: Machines,
) -> None:
    """Another leg's smooth error beside the effect's: what else acts is not told where
    the effect is all there is.
    """
    rng, problem = np.random.default_rng(23), machines.problem
    state, right = problem.states[0], {True: 0, False: 0}
    odd = rng.standard_normal(len(state.time))
    columns = np.column_stack([case.in_joint(problem, k, 1e-6 * odd) for k in range(3)])
    for k in range(9):
        change = case.sized(columns[:, k % 3], machines.covariance, 6.0)
        other = case.in_joint(
            problem, (k + 1) % 3, 1e-6 * state.motion_sign[:, (k + 1) % 3]
        )
        r = (
            change
            + case.sized(other, machines.covariance, 7.0)
            + machines.root @ rng.standard_normal(len(problem))
        )
        for known in right:
            blocks = locate(
                problem.with_residual(r),
                machines.law,
                rng,
                columns=columns,
                labels=LEGS,
                known=known,
                draws=50,
            )
            right[known] += first(blocks, "leg") == LEGS[k % 3]
    assert right[True] >= 8
    assert right[False] <= 4


def test_a_selected_wave_is_told_in_a_run_that_has_it(machines: Machines) -> None:
    """A wave too fast for the harmonics of the runs, in two of them."""
    rng, problem = np.random.default_rng(24), machines.problem
    clock = problem.rows["time"].to_numpy(dtype=float)
    columns = np.column_stack([np.cos(clock / 4.7), np.sin(clock / 4.7)])
    names, right, blind = (
        [f"run {problem.rows['run'][b[0]]}" for b in problem.members],
        0,
        0,
    )
    for k in range(6):
        acting, change = (k, (k + 2) % 6), np.zeros(len(problem))
        for run in acting:
            change[problem.members[run]] = columns[problem.members[run]] @ [0.6, 0.8]
        r = case.sized(
            change, machines.covariance, 9.0
        ) + machines.root @ rng.standard_normal(len(problem))
        here = problem.with_residual(r)
        blocks = locate(
            here,
            machines.law,
            rng,
            columns=columns,
            labels=["", ""],
            known=True,
            draws=100,
        )
        best = next(b for b in blocks if b.block.startswith("run"))
        right += best.block in [names[run] for run in acting] and best.p_value < 0.02
        without = locate(here, machines.law, rng, draws=100)
        blind += next(b for b in without if b.block.startswith("run")).p_value < 0.02
    assert right == 6
    assert blind <= 2


def test_what_acts_in_some_runs_is_told_in_each_by_all_of_them(
    machines: Machines,
) -> None:
    """A resonance at one feed: too weak in any of its runs, plain in all of them; none
    is told of what acts in all.
    """
    rng, problem = np.random.default_rng(26), machines.problem
    names = [f"run {problem.rows['run'][b[0]]}" for b in problem.members]
    acting = np.isin(
        np.arange(len(problem)), np.concatenate([problem.members[k] for k in (1, 3, 4)])
    )
    odd = rng.standard_normal(len(problem))
    change = np.where(acting, odd, 0.0)
    r = case.sized(
        change, machines.covariance, 6.0
    ) + machines.root @ rng.standard_normal(len(problem))
    here = problem.with_residual(r)

    def run_p_values(columns: np.ndarray) -> dict[str, float]:
        blocks = locate(
            here,
            machines.law,
            np.random.default_rng(1),
            columns=columns,
            labels=[""],
            draws=100,
        )
        return {
            b.block: b.p_value
            for b in blocks
            if b.block.startswith("run") and b.p_value < 0.02
        }

    some = run_p_values(change[:, None])
    assert set(some) == {names[k] for k in (1, 3, 4)}
    assert len(set(some.values())) == 1
    assert (
        len(
            run_p_values(
                np.where(acting, odd, rng.standard_normal(len(problem)))[:, None]
            )
        )
        < 3
    )


@pytest.mark.parametrize(("low", "high", "reported"), [
    (0.30, 0.55, (0.30, 0.55)), (0.62, 1.0, (0.62, 1.0)), (0.0, 0.62, (0.62, 1.0)),
])  # fmt: skip
def test_a_selected_step_tells_its_own_time(
    machines: Machines, low: float, high: float, reported: tuple
) -> None:
    """To the reading, where cells of the session tell it to a sixteenth; what ends is
    told from its end on.
    """
    p, rng = machines.problem, np.random.default_rng(31)
    time = p.rows["time"].to_numpy()
    share = (time - time.min()) / np.ptp(time)
    (state,) = p.states
    at = (state.time - time.min()) / np.ptp(time)
    change = case.in_joint(p, 1, ((at >= low) & (at <= high)).astype(float))
    column = change[:, None] / np.abs(change).max()
    r = machines.root @ rng.standard_normal(len(p)) + case.sized(
        change, machines.covariance, 12.0
    )
    blocks = locate(
        p.with_residual(r),
        machines.law,
        rng,
        columns=column,
        labels=["leg 2"],
        known=True,
    )
    inside = time[(share >= reported[0]) & (share <= reported[1])]
    begin = 0.5 * (inside.min() + time[time < inside.min()].max())
    after = time[time > inside.max()]
    end = 0.5 * (inside.max() + after.min()) if after.size else inside.max()
    assert first(blocks, "time") == f"time {begin:.0f}-{end:.0f}"
    assert first(blocks, "leg") == "leg 2"


# -- legs by their coefficients --------------------------------------------------------


def posterior(
    G: np.ndarray, covariance: np.ndarray, r: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the coefficients, by the textbook."""
    precision = G.T @ np.linalg.solve(covariance, G) + np.diag(scale**-2.0)
    return np.linalg.solve(
        precision, G.T @ np.linalg.solve(covariance, r)
    ), np.linalg.inv(precision)


def test_legs_of_is_the_test_of_a_block_beside_the_others(
    machines: Machines, rng: np.random.Generator
) -> None:
    labels, scale = (
        ["leg 1", "leg 1", "leg 2", "", "leg 3"],
        np.array([1.0, 0.3, 2.0, 1.0, 0.5]),
    )
    G = rng.standard_normal((len(machines.problem), 5))
    r = machines.root @ rng.standard_normal(len(G)) + G @ [0.1, 0.2, -0.6, 1.0, 0.0]
    by_block = {
        b.block: b
        for b in effect_legs(
            labels, *posterior(G, machines.covariance, r, scale), scale=scale
        )
    }
    p_values = {}
    for name in ("leg 1", "leg 2", "leg 3"):
        mine = np.array([label == name for label in labels])
        rest = machines.covariance + (G[:, ~mine] * scale[~mine] ** 2) @ G[:, ~mine].T
        B, MB = G[:, mine], np.linalg.solve(rest, G[:, mine])
        p_values[name] = stats.chi2.sf(
            r @ MB @ np.linalg.solve(B.T @ MB, MB.T @ r), mine.sum()
        )
    ranked = sorted(p_values, key=p_values.__getitem__)
    holm = np.maximum.accumulate(
        [min(p_values[n] * (3 - k), 1.0) for k, n in enumerate(ranked)]
    )
    assert_allclose([by_block[n].p_value for n in ranked], holm, rtol=1e-5)
    assert sum(b.strength for b in by_block.values()) == pytest.approx(1.0)
    assert list(by_block) == ranked


def test_legs_of_tells_the_leg_and_is_quiet_without_one(machines: Machines) -> None:
    rng = np.random.default_rng(8)
    state, scale = machines.problem.states[0], np.ones(3)
    G = np.column_stack(
        [
            case.in_joint(machines.problem, k, 3e-6 * state.motion_sign[:, k])
            for k in range(3)
        ]
    )
    labels, alarms, right = ["leg 1", "leg 2", "leg 3"], 0, 0
    for k in range(200):
        quiet = machines.root @ rng.standard_normal(len(G))
        alarms += (
            effect_legs(labels, *posterior(G, machines.covariance, quiet, scale))[
                0
            ].p_value
            <= 0.05
        )
        loud = quiet + case.sized(G[:, k % 3], machines.covariance, 6.0)
        best = effect_legs(labels, *posterior(G, machines.covariance, loud, scale))[0]
        right += best.block == labels[k % 3] and best.p_value < 0.05
    assert 2 <= alarms <= 20
    assert right >= 0.95 * 200


def test_legs_of_refuses_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        effect_legs(["leg 1"], np.zeros(2), np.eye(2))
