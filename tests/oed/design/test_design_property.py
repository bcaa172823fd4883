"""No design is below the greedy one, nor above its bound: 25 random problems."""

import dataclasses

import numpy as np

from oed.design import Choice, Rules, choose
from oed.design.rules import SetupLimit, TimeBudget

CRITERIA = ("D", "A", "O5", "D", "A", "O5", "D", "E")


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Blocks of rank r in n columns, a prior or none, and rules."""

    blocks: np.ndarray
    prior: np.ndarray | None
    rules: Rules
    criterion: str
    rank: int


def problem(seed: int) -> Problem:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    k = int(rng.integers(1, 4))
    count = int(rng.integers(15, 50))
    rank = n if seed % 3 else max(1, n - int(rng.integers(1, 3)))
    blocks = rng.standard_normal((count, k, rank)) @ rng.standard_normal((rank, n))
    blocks = blocks @ np.diag(10.0 ** rng.uniform(-1, 1, n))
    prior = np.diag(10.0 ** rng.uniform(-2, 1, n)) if seed % 2 else None
    size = int(rng.integers(-(-n // k) + 1, 12))
    rules = Rules(size=size)
    if seed % 5 == 0:
        cost = rng.uniform(0.5, 2.0, count)
        rules = Rules(
            time=TimeBudget(cost, float(rng.uniform(n + 2, n + 6)) * 2.0),
            size=None if seed % 2 else 12,
        )
    elif seed % 5 == 1:
        rules = Rules(size=size, setups=SetupLimit(rng.integers(0, 4, count), most=2))
    return Problem(blocks, prior, rules, CRITERIA[seed % 8], rank)


def value(p: Problem, chosen: np.ndarray, ridge: float = 0.0) -> float:
    """log phi over the directions seen, from eigenvalues."""
    flat = p.blocks[chosen].reshape(-1, p.blocks.shape[2])
    m = flat.T @ flat + (0.0 if p.prior is None else p.prior)
    if p.prior is None:
        basis = np.linalg.svd(
            p.blocks.reshape(-1, p.blocks.shape[2]), full_matrices=False
        )[2][: p.rank].T
        m = basis.T @ m @ basis
    w = np.maximum(np.linalg.eigvalsh(m + ridge * np.eye(len(m))), 1e-300)
    if p.criterion == "D":
        return float(np.log(w).mean())
    if p.criterion == "A":
        return -float(np.log(np.sum(1.0 / w)))
    return (
        float(np.log(w[0]))
        if p.criterion == "E"
        else -2.0 * float(np.log(np.mean(w**-0.5)))
    )


def greedy(p: Problem) -> np.ndarray:
    """Forward selection by log det under the rules."""
    chosen: list[int] = []
    by_d = dataclasses.replace(p, criterion="D")
    ridge = 1e-9 * float(np.mean(np.sum(p.blocks**2, axis=(1, 2))))
    while (
        free := np.flatnonzero(
            p.rules.additions(np.array(chosen, dtype=int), len(p.blocks))
        )
    ).size:
        chosen.append(
            max(free, key=lambda j: value(by_d, np.array([*chosen, j]), ridge))
        )
    return np.array(chosen)


def test_greedy_is_never_better_and_the_bound_never_crossed():
    for seed in range(25):
        p = problem(seed)
        rng, how = (
            np.random.default_rng(seed),
            {"prior": p.prior, "rounds": 2, "rules": p.rules},
        )
        choice = choose(p.blocks, None, rng, p.criterion, **how)
        chosen = choice.indices
        reached = value(p, chosen)
        assert len(set(chosen)) == len(chosen), seed
        seen = p.rank if p.prior is None else p.blocks.shape[2]
        assert choice.directions == seen, seed
        for k in range(len(chosen)):
            assert p.rules.additions(np.delete(chosen, k), len(p.blocks))[chosen[k]], (
                seed
            )
        assert reached >= value(p, greedy(p)) - 1e-7, seed
        assert choice.efficiency is not None, seed
        assert 0.0 < choice.efficiency <= 1.0, seed
        assert reached <= log_bound(p, choice) + 1e-7, seed


def log_bound(p: Problem, choice: Choice) -> float:
    """The bound as log phi."""
    assert choice.bound is not None
    if p.criterion == "D":
        return choice.bound / choice.directions
    if p.criterion == "A":
        return -float(np.log(-choice.bound))
    return float(
        np.log(choice.bound)
        if p.criterion == "E"
        else 2.0 * np.log(choice.bound * choice.directions)
    )
