"""How deep must a tree branch before it lowers the bound of an E-optimal plan?

    python benchmarks/e_bound.py [--orders 3]

Thirty of 2000 normal rows with 21 columns. Any tree that branches on rows has a node in
which the first k rows of the best known plan are taken, whatever its order. The bound of
the tree is at least the relaxation of that node. The table has this relaxation over the
best known value, for random orders of the plan's rows. The other rows come from a pool
of the longest ones: a smaller pool can only give a lower figure, so that what is printed
holds for all rows too.
"""

from __future__ import annotations

import argparse

import numpy as np

from oed.design import choose, conic
from oed.design.forms.eigenvalues import ExtremeEigenvalues

CANDIDATES, COLUMNS, SIZE = 2000, 21, 30
#: longest rows beside those of the plan
POOL = 350
TAKEN = (0, 5, 10, 15, 20, 25)


def relaxed(rows: np.ndarray, taken: np.ndarray, others: np.ndarray) -> float:
    """The largest least eigenvalue that weights of `others` reach beside `taken` rows."""
    prior = rows[taken].T @ rows[taken]
    size = float(SIZE - len(taken))
    relaxation = conic.relax(rows[others], size, ExtremeEigenvalues(), prior)
    return float(np.exp(relaxation.value))


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orders", type=int, default=3)
    orders = parser.parse_args().orders
    rows = np.random.default_rng(0).standard_normal((CANDIDATES, COLUMNS))
    rng = np.random.default_rng(1)
    choice = choose(rows, SIZE, rng, "E", rounds=20, certify=False)
    plan = np.asarray(choice.indices)
    value = float(np.linalg.eigvalsh(rows[plan].T @ rows[plan])[0])
    longest = np.argsort(-np.sum(rows**2, axis=1))[:POOL]
    print(f"plan {value:.3f}; node's relaxation over the plan")
    print(
        "| rows taken | " + " | ".join(f"order {k + 1}" for k in range(orders)) + " |"
    )
    print("|" + " --: |" * (orders + 1))
    permutations = [rng.permutation(plan) for _ in range(orders)]
    for number in TAKEN:
        ratios = []
        for order in permutations:
            taken = order[:number]
            others = np.setdiff1d(np.union1d(longest, plan), taken)
            ratios.append(relaxed(rows, taken, others) / value)
        print(f"| {number} | " + " | ".join(f"{r:.2f}" for r in ratios) + " |")


if __name__ == "__main__":
    main()
