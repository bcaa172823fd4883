"""Proven optima of small and middle designs, and how far this project's plans are from them.

    python -m benchmarks.exact_designs [--seed N]

Of ten small instances (3 columns) by A, I and G all 2002 plans are valued. Twenty others are
closed by branch and bound on the relaxation (Ahipasaoglu 2021), whose bounds rest on dual
points: D, A and I by `oed.design.branch`, E (more plans than are all tried) by a tree of its
own. The gap is the relative excess of the plan's phi^-1: variance, det M^(-1/n) or 1 / l_min.
Seeds are drawn at run time, and printed.

`weights` is how many times the optimum's l_min the relaxation's weights reach. No bound by this
relaxation can be lower, whatever the solver, so that it is what whole rows cost: where the
gap is 0, no part of the bound's distance comes from the plan.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
from typing import NamedTuple

import numpy as np

from benchmarks.harness.tables import head, row
from benchmarks.peers import processor_seconds
from oed.design import CRITERIA, Criterion, branch, choose, condition

#: candidates, columns and readings of the small and of the middle instances, and those of E
SMALL = (14, 3, 5)
MIDDLE = ((40, 5, 9), (40, 6, 10))
OF_E = ((30, 4, 6), (24, 5, 7))
MAX_NODES = 4000  #: nodes of a tree
EQUAL = 1e-6  #: relative difference of variances that counts as none
E = CRITERIA["E"].properties  #: it has no columns of its own
COLUMNS = [
    "by",
    "criterion",
    "candidates",
    "columns",
    "readings",
    "plan",
    "optimum",
    "gap",
    "weights",
    "s",
]


class Instance(NamedTuple):
    """Rows (C, n) of which `size` are chosen; `accuracy` (J, r, n) of I and G."""

    criterion: str
    rows: np.ndarray
    size: int
    accuracy: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """W_j (J, n, n): the criterion is the largest tr(W_j S)."""
        n = self.rows.shape[1]
        products = np.swapaxes(self.accuracy, 1, 2) @ self.accuracy
        if self.criterion == "G":
            return products
        mean = np.eye(n) if self.criterion == "A" else products.mean(axis=0)
        return mean[None]

    def variance(self, chosen: np.ndarray) -> float:
        """The largest tr(W_j S) of a plan; of D det M^(-1/n), of E 1 / l_min."""
        rows = self.rows[chosen]
        if self.criterion in "DE":
            eigenvalues = np.linalg.eigvalsh(rows.T @ rows)
            geometric = np.exp(np.log(eigenvalues).mean())
            return float(1.0 / (eigenvalues[0] if self.criterion == "E" else geometric))
        covariance = np.linalg.inv(rows.T @ rows)
        return float(np.einsum("jab,ab->j", self.weights, covariance).max())


def draw(criterion: str, shape: tuple[int, int, int], seed: int) -> Instance:
    """Normal rows, and four normal poses of two components."""
    rng = np.random.default_rng(seed)
    count, n, size = shape
    rows = rng.standard_normal((count, n))
    return Instance(criterion, rows, size, rng.standard_normal((4, 2, n)))


def optimum_of_all_plans(instance: Instance, known: float) -> float:
    """The least variance of all plans; they are few enough to need none that is known."""
    plans = itertools.combinations(range(len(instance.rows)), instance.size)
    return min(instance.variance(np.array(plan)) for plan in plans)


def e_optimum(instance: Instance, known: float) -> float:
    """1 / l_min at its least by branch and bound; NaN where its nodes end first.

    Starts from a plan of 1 / l_min `known`. The node with the highest bound is split at the
    row whose weight is nearest to a half.
    """
    rows, size, best = instance.rows, instance.size, 1.0 / known
    ticket = itertools.count()
    nothing, everything = np.zeros(0, dtype=int), np.arange(len(rows))
    heap = [(-np.inf, next(ticket), nothing, everything)]
    while heap and -heap[0][0] > best * (1.0 + EQUAL):
        _, number, taken, others = heapq.heappop(heap)
        if number > 2 * MAX_NODES:
            return np.nan
        missing = size - len(taken)
        plan, bound = np.concatenate([taken, others[:missing]]), -np.inf
        if 0 < missing < len(others):
            prior = rows[taken].T @ rows[taken]
            relaxed = condition.relax(E, rows[others], float(missing), prior)
            heaviest = others[np.argsort(-relaxed.weights)[:missing]]
            plan, bound = np.concatenate([taken, heaviest]), np.exp(relaxed.bound)
        best = max(best, 1.0 / instance.variance(plan))
        if bound > best * (1.0 + EQUAL):
            middle = int(np.argmin(np.abs(relaxed.weights - 0.5)))
            rest = np.delete(others, middle)
            for child in (np.append(taken, others[middle]), taken):
                heapq.heappush(heap, (-bound, next(ticket), child, rest))
    return 1.0 / best


def weights_reach(instance: Instance, variance: float) -> float:
    """Least eigenvalue of the relaxation's weights over that of a plan, for E."""
    relaxed = condition.relax(E, instance.rows, float(instance.size))
    return float(np.exp(relaxed.value)) * variance


def branched_optimum(instance: Instance, known: float) -> float:
    """The least variance by branch and bound; NaN where its nodes end first."""
    if instance.criterion == "E":
        return e_optimum(instance, known)
    rng = np.random.default_rng(2)
    criterion = _criterion(instance)
    result = branch.solve(instance.rows, instance.size, rng, criterion, nodes=MAX_NODES)
    if result.bound - result.value > EQUAL:
        return np.nan
    return instance.variance(result.indices)


def _criterion(instance: Instance) -> Criterion:
    columns = instance.rows.shape[1]
    accuracy = instance.accuracy if instance.criterion in "IG" else None
    return CRITERIA.build(instance.criterion, columns, accuracy)


def chosen_variance(instance: Instance) -> float:
    """The variance of this program's plan."""
    rng = np.random.default_rng(1)
    choice = choose(instance.rows, instance.size, rng, _criterion(instance))
    return instance.variance(choice.indices)


def main() -> None:
    """Print one row an instance, and the largest gap."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, help="drawn where it is left out")
    seed = parser.parse_args().seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    seeds = np.random.SeedSequence(seed).generate_state(30)
    shapes = [("all plans", c, SMALL) for c in "AAAIIIGGGG"]
    shapes += [("tree", c, shape) for c in "DAI" for shape in MIDDLE for _ in range(2)]
    shapes += [("tree", "E", shape) for shape in OF_E for _ in range(4)]
    print(f"seed {seed}")
    print(head(*COLUMNS))
    gaps = []
    for (method, criterion, shape), drawn in zip(shapes, seeds, strict=True):
        instance = draw(criterion, shape, int(drawn))
        plan = chosen_variance(instance)
        start = processor_seconds()
        solve = branched_optimum if method == "tree" else optimum_of_all_plans
        optimum = solve(instance, plan)
        gap, seconds = plan / optimum - 1.0, processor_seconds() - start
        gaps.append(gap)
        ratio = f"{weights_reach(instance, optimum):.2f}" if criterion == "E" else "-"
        values = (
            f"{plan:.5f}",
            f"{optimum:.5f}",
            f"{gap:.1e}",
            ratio,
            f"{seconds:.1f}",
        )
        print(row(method, criterion, *shape, *values), flush=True)
    closed = np.array([g for g in gaps if np.isfinite(g)])
    print(f"closed: {len(closed)} of {len(gaps)}; largest gap {closed.max():.1e}")


if __name__ == "__main__":
    main()
