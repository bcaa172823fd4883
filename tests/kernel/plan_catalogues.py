"""Small catalogues whose readings are linear, and all of their plans."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from oed.design.candidates import Candidates
from oed.design.stages.goal import Goal
from oed.design.stages.option import Option
from oed.design.stages.search import PlanSearchResult, search_plan
from oed.design.stages.stage import travel
from oed.design.stages.stage.knowledge import Prior
from oed.design.stages.stage.prediction import PlanStage, predict_stage
from oed.design.stages.streams import PlanStreams


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
    """A measurement with n machine and r set-up parameters, all of tolerance 1."""

    def __init__(self, n: int, r: int) -> None:
        self.machine = SimpleNamespace(parameters=range(n))
        self.nominal, self.tolerance = np.zeros(n + r), np.ones(n + r)
        self.free = np.ones(n + r, dtype=bool)
        self.setups = {"s": SimpleNamespace(sigma=(1.0,))}

    def jacobian(self, series: tuple[Rows, ...], at: np.ndarray) -> np.ndarray:
        return np.vstack([s.rows for s in series])

    def readings(self, series: tuple[Rows, ...], theta: np.ndarray) -> np.ndarray:
        return theta @ self.jacobian(series, theta).T

    def try_readings(
        self,
        series: tuple[Rows, ...],
        theta: np.ndarray,
        wanted: np.ndarray | None = None,
    ) -> np.ndarray:
        return self.readings(series, theta)

    def sigma(self, series: tuple[Rows, ...]) -> np.ndarray:
        return np.ones(sum(len(s) for s in series))


def linear_option(
    name: str,
    rows: np.ndarray,
    n: int,
    *,
    counts: tuple[int, ...],
    mounting: float,
    seconds: np.ndarray,
    travel: float = math.inf,
) -> Option:
    """An option of single readings with rows (C, n + r)."""
    count, width = rows.shape
    candidates = Candidates(
        measurement=Linear(n, width - n),  # type: ignore[arg-type]
        series=(Rows(rows),),  # type: ignore[arg-type]
        blocks=rows[:, None, :],
        columns=width,
        prior_information=np.zeros((width, width)),
        members=np.column_stack([np.arange(count), np.ones(count, dtype=int)]),
        setups=("s",),
        setup=np.zeros(count, dtype=int),
        command=np.zeros((count, 1)),
        cost=seconds,
        setup_cost=np.array([mounting]),
    )
    return Option(name, candidates, counts, mounting, seconds, travel)


def catalogue(
    rng: np.random.Generator,
    *,
    options: int = 3,
    n: int = 3,
    size: int = 5,
    equal_times: bool = True,
    targets: bool = False,
) -> tuple[list[Option], Goal]:
    """Options that each determine some directions well, and a goal of two components.

    Each option has one parameter of its own.
    """
    catalogue = []
    for k in range(options):
        strength = 10.0 ** rng.uniform(0.0, 1.5, n)
        of_machine = rng.standard_normal((size, n)) * strength
        of_setup = 3.0 * rng.standard_normal(size)
        seconds = np.full(size, 60.0)
        if not equal_times:
            seconds = rng.uniform(20.0, 120.0, size)
        option = linear_option(
            f"o{k}",
            np.column_stack([of_machine, of_setup]),
            n,
            counts=tuple(range(1, size)),
            mounting=float(rng.uniform(100.0, 600.0)),
            seconds=seconds,
        )
        catalogue.append(option)
    factors = rng.standard_normal((2, 2, n))
    factors /= np.sqrt(np.sum(factors**2, axis=(1, 2)))[:, None, None]
    return catalogue, Goal(("a", "b"), factors, np.ones(2), targets)


def every_plan(
    options: list[Option], goal: Goal, stages: int
) -> tuple[np.ndarray, np.ndarray]:
    """Values and times of every set of readings of at most `stages` options.

    Computed by the joint inverse of all unknowns.
    """
    n = goal.factors.shape[2]
    information, time, used = np.eye(n)[None], np.zeros(1), np.zeros(1)
    for option in options:
        gains, seconds = every_subset(option, n)
        information = (information[:, None] + gains[None]).reshape(-1, n, n)
        time = (time[:, None] + seconds[None]).ravel()
        used = (used[:, None] + (seconds > 0.0)[None]).ravel()
    allowed = used <= stages
    covariance = np.linalg.inv(information[allowed])
    variance = np.einsum(
        "krn,pnm,krm->pk", goal.factors, covariance, goal.factors, optimize=True
    )
    accuracy = np.sqrt(variance)
    if goal.has_targets:
        return accuracy.max(axis=1), time[allowed]
    return np.sqrt(np.mean(accuracy**2, axis=1)), time[allowed]


def every_subset(option: Option, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Information about the machine, and time, of every set of an option's readings."""
    rows, size = option.candidates.blocks[:, 0], len(option.candidates)
    gains, times = [np.zeros((n, n))], [0.0]
    for count in range(1, option.counts[-1] + 1):
        for subset in itertools.combinations(range(size), count):
            chosen = list(subset)
            joint = np.eye(rows.shape[1]) + rows[chosen].T @ rows[chosen]
            of_machine = np.linalg.inv(np.linalg.inv(joint)[:n, :n])
            gains.append(of_machine - np.eye(n))
            seconds = option.candidate_seconds[chosen].sum()
            times.append(option.mounting_seconds + seconds)
    return np.array(gains), np.array(times)


def streams(seed: int) -> PlanStreams:
    """Random streams of a search; `seed` is for the first look at partial plans."""
    return PlanStreams(
        first_look=np.random.default_rng(seed),
        bound=np.random.default_rng(19),
        capture=lambda: np.random.default_rng(0),
        refinement=lambda stage: np.random.default_rng([17, stage]),
        verification=lambda stage: np.random.default_rng([18, stage]),
    )


def searched(
    options: Sequence[Option],
    goal: Goal,
    budget: float,
    *,
    seed: int = 0,
    stages: int = 4,
    beam: int = 6,
) -> PlanSearchResult:
    """The best plan of a catalogue."""
    return search_plan(options, goal, budget, streams(seed), stages=stages, beam=beam)


def capture(option: Option, prior: Prior) -> np.ndarray:
    """Capture probability (C,) of each candidate, on the same machines at each call."""
    return travel.capture_probability(option, prior, np.random.default_rng(0))


def stage_after(
    option: Option,
    chosen: np.ndarray,
    prior: Prior,
    rng: np.random.Generator,
    exact: bool = True,
    draws: int | None = None,
) -> PlanStage:
    """A stage with the capture probability that follows from the prior."""
    probability = capture(option, prior)
    return predict_stage(option, chosen, prior, probability, rng, exact, draws)
