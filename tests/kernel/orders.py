"""A plane of poses to order, and its shortest path by trial."""

from itertools import pairwise, permutations

import numpy as np


def problem(
    seed: int, n: int, forbidden: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths (n, n) that differ there and back, some of them forbidden, from the start
    (n,) and to the finish (n,).
    """
    rng = np.random.default_rng(seed)
    distance = rng.uniform(size=(n, n))
    distance[rng.uniform(size=(n, n)) < forbidden] = np.inf
    return distance, rng.uniform(size=n), rng.uniform(size=n)


def along(
    path: list[int] | tuple[int, ...] | np.ndarray, distance: np.ndarray
) -> float:
    return float(sum(distance[a, b] for a, b in pairwise(path)))


def shortest(distance: np.ndarray, start: np.ndarray, finish: np.ndarray) -> float:
    """Of all permutations."""
    return min(
        start[p[0]] + along(p, distance) + finish[p[-1]]
        for p in permutations(range(len(distance)))
    )


def plane(seed: int, n: int) -> np.ndarray:
    x = np.random.default_rng(seed).uniform(size=(n, 2))
    return np.linalg.norm(x[:, None] - x, axis=-1)
