"""Small catalogues whose readings are linear, and all of their plans."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np

from oed.design.candidates import Candidates
from oed.planning.goal import Goal
from oed.planning.option import Option


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Readings y = rows @ theta with noise of 1; stands for a Series."""

    rows: np.ndarray
    setup: str = "s"

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, chosen: np.ndarray) -> "Rows":
        return Rows(self.rows[chosen])


class Linear:
    """A measurement with n machine parameters and r unknowns of its own, all of
    tolerance 1.
    """

    def __init__(self, n: int, r: int) -> None:
        self.machine = SimpleNamespace(parameters=range(n))
        self.nominal, self.tolerance = np.zeros(n + r), np.ones(n + r)
        self.free = np.ones(n + r, dtype=bool)
        self.setups = {"s": SimpleNamespace(sigma=(1.0,))}

    def jacobian(self, series: tuple[Rows, ...], at: np.ndarray) -> np.ndarray:
        return np.vstack([s.rows for s in series])

    def readings(self, series: tuple[Rows, ...], theta: np.ndarray) -> np.ndarray:
        return theta @ self.jacobian(series, theta).T

    try_readings = readings

    def sigma(self, series: tuple[Rows, ...]) -> np.ndarray:
        return np.ones(sum(len(s) for s in series))


def option(
    name: str, rows: np.ndarray, n: int, *, counts: tuple[int, ...], mounting: float, seconds: np.ndarray,
    travel: float | None = None,
) -> Option:  # fmt: skip
    """An option of single readings with rows (C, n + r)."""
    count, wide = rows.shape
    found = Candidates(
        measurement=Linear(n, wide - n),  # type: ignore[arg-type]
        series=(Rows(rows),),  # type: ignore[arg-type]
        blocks=rows[:, None, :],
        columns=wide,
        held=np.zeros((wide, wide)),
        members=np.column_stack([np.arange(count), np.ones(count, dtype=int)]),
        setups=("s",),
        setup=np.zeros(count, dtype=int),
        place=np.zeros((count, 1)),
        cost=seconds,
        setup_cost=np.array([mounting]),
    )
    return Option(name, found, counts, mounting, seconds, travel)


def catalogue(
    rng: np.random.Generator,
    *,
    options: int = 3,
    n: int = 3,
    size: int = 5,
    alike: bool = True,
    wanted: bool = False,
) -> tuple[list[Option], Goal]:
    """Options that each see some directions well, with one unknown of their own; a goal
    of two components.
    """
    made = []
    for k in range(options):
        strength = 10.0 ** rng.uniform(0.0, 1.5, n)
        rows = np.column_stack(
            [rng.standard_normal((size, n)) * strength, 3.0 * rng.standard_normal(size)]
        )
        seconds = np.full(size, 60.0) if alike else rng.uniform(20.0, 120.0, size)
        mounting = float(rng.uniform(100.0, 600.0))
        counts = tuple(range(1, size))
        made.append(
            option(f"o{k}", rows, n, counts=counts, mounting=mounting, seconds=seconds)
        )
    factors = rng.standard_normal((2, 2, n))
    factors /= np.sqrt(np.sum(factors**2, axis=(1, 2)))[:, None, None]
    return made, Goal(("a", "b"), factors, np.ones(2), wanted)


def every_plan(
    options: list[Option], goal: Goal, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Values and times of every set of readings of at most `most` options, by the joint
    inverse of all unknowns.
    """
    n = goal.factors.shape[2]
    gains, times = [], []
    for o in options:
        rows, size = o.candidates.blocks[:, 0], len(o.candidates)
        subsets = [
            c
            for k in range(1, o.counts[-1] + 1)
            for c in itertools.combinations(range(size), k)
        ]
        each, spent = [np.zeros((n, n))], [0.0]
        for chosen in subsets:
            joint = np.eye(rows.shape[1]) + rows[list(chosen)].T @ rows[list(chosen)]
            each.append(np.linalg.inv(np.linalg.inv(joint)[:n, :n]) - np.eye(n))
            spent.append(o.mounting + o.seconds[list(chosen)].sum())
        gains.append(np.array(each))
        times.append(np.array(spent))
    held, time, used = np.eye(n)[None], np.zeros(1), np.zeros(1)
    for gain, spent in zip(gains, times, strict=True):
        held = (held[:, None] + gain[None]).reshape(-1, n, n)
        time = (time[:, None] + spent[None]).ravel()
        used = (used[:, None] + (spent > 0.0)[None]).ravel()
    kept = used <= most
    covariance = np.linalg.inv(held[kept])
    accuracy = np.sqrt(
        np.einsum(
            "krn,pnm,krm->pk", goal.factors, covariance, goal.factors, optimize=True
        )
    )
    value = (
        accuracy.max(axis=1) if goal.wanted else np.sqrt(np.mean(accuracy**2, axis=1))
    )
    return value, time[kept]
