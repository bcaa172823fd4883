"""What forms of effects are worth: expected log Bayes factors, in three worlds.

    python -m benchmarks.second.forms --effect friction --cases 12

draws cases of an effect of sqrt(lambda) 10 in white noise on the machines of the second
generator and of the third world. Printed are the log Bayes factors of the effect over
none, on average over noise, with the library's form and with each kind of the columns
that adapt it withheld. Whoever knew the change but for its size would have some 47.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import collections
import contextlib
import dataclasses
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from scipy import special

from benchmarks.second import cases as case_files
from benchmarks.second.adapter import MACHINES
from benchmarks.second.cases import Case
from benchmarks.second.replay import Generator
from benchmarks.third import cases as third_cases
from oed.base import Array, Index
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as libraries
from oed.model.effect import Column, Effect, State
from oed.model.size_prior import EFFECT_SIZES
from oed.noise import SharedError

#: sqrt(lambda) of the effects, and noises that a mean is over
SIZE, NOISES = 10.0, 16


@dataclasses.dataclass(frozen=True)
class ChangedReadings:
    """A case with one effect.

    problem    its residuals
    effects    that the diagnosis would try
    change     (N,) exact change of the readings, over the stated noise
    """

    problem: GapProblem
    effects: tuple[Effect, ...]
    change: Array


def second_case(
    generator: Generator, machine: str, effect: str, seed: int
) -> ChangedReadings:
    """A case of the second generator in which the effect acts."""
    make: Any = generator.make
    pool = generator.effects.LISTED | generator.effects.NEVER
    with mock.patch.object(make, "LISTED", {effect: pool[effect]}):
        kind = ("single", "white", int(SIZE))
        replay = generator.replay(seed, machine, 0, kind)
    with tempfile.TemporaryDirectory() as folder:
        stem = Path(folder) / "cases" / machine / "case_000"
        stem.parent.mkdir(parents=True)
        make.write(replay.case, replay.readings, replay.label, stem)
        with_it, effects = case_files.prepare(Case(Path(folder), machine, stem.name))
        changed = replay.readings - replay.sigma * replay.change
        make.write(replay.case, changed, replay.label, stem)
        without, _ = case_files.prepare(Case(Path(folder), machine, stem.name))
    return ChangedReadings(with_it, effects, (with_it.y - without.y) / with_it.sigma)


def third_case(effect: str, seed: int) -> ChangedReadings:
    """A case of the third world in which the effect acts, beside small faults."""
    original: Any = third_cases._fault

    def absent(sight: Any, name: str, size: float, rng: np.random.Generator) -> Array:
        fault = original(sight, name, size, rng)
        return np.asarray(fault * (0.0 if size == SIZE else 1.0))

    problems = []
    for fault in (original, absent):
        with contextlib.ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            for name, value in {
                "_names": lambda *_: [effect],
                "SIZES": (SIZE,),
                "NOISES": ("white",),
                "_fault": fault,
            }.items():
                stack.enter_context(mock.patch.object(third_cases, name, value))
            machine, _ = third_cases.write(folder, seed)
            problems.append(case_files.prepare(Case(folder, machine, "case_000")))
    (with_it, effects), (without, _) = problems
    return ChangedReadings(with_it, effects, (with_it.y - without.y) / with_it.sigma)


def log_factor(case: ChangedReadings, effect: Effect) -> float:
    """Log Bayes factor of an effect over none, its mean over `NOISES` noises.

    Readings are the exact change and white noise, geometry drawn from its tolerances.
    """
    problem = case.problem
    metric = Metric(problem, problem.stated_law)
    library = libraries.build(problem, [effect], metric)
    if not library.atoms:
        return 0.0
    white = evidence.WhitenedColumns(problem, metric, library.columns)
    grams = white.grams()
    residuals = case.change[:, None] + _noise(problem)
    slopes = white._columns.T @ metric.scores(residuals)
    choices = [atom.columns for atom in library.atoms]
    energy = np.array([grams.gram.diagonal()[c].sum() for c in choices])
    log_prior = EFFECT_SIZES.log_visible_shares(energy)
    log_prior += np.array([atom.log_weight for atom in library.atoms])[:, None]
    values = [_over_forms(grams, choices, b, log_prior) for b in slopes.T]
    return float(np.mean(values))


def _over_forms(
    grams: Grams, choices: list[Index], slopes: Array, log_prior: Array
) -> float:
    """Log evidence of all forms and sizes over none at the stated noise."""
    table = log_prior.copy()
    for numbers, rows in evidence.group_by_count(choices):
        part = grams.gram[rows[:, :, None], rows[:, None, :]]
        least = evidence.ROUNDING * grams.whole[rows].max(axis=1, initial=0.0)
        gain, log_det = evidence.explained_energy(
            part, slopes[rows], EFFECT_SIZES.values, least
        )
        table[numbers] += 0.5 * (gain - log_det)
    return float(special.logsumexp(table))


def _noise(problem: GapProblem) -> Array:
    """Noise (N, NOISES) over the stated one, with what geometry makes of it."""
    rng = np.random.default_rng(len(problem))
    shape = (len(problem), NOISES)
    noise = rng.standard_normal(shape)
    if (
        problem.structure.kinds == SharedError.KNOWN
    ).any():  # half the variance is that of the reference
        keys = problem.rows["run"].astype(str) + problem.rows["channel"].astype(str)
        _, owner = np.unique(keys.to_numpy(dtype=str), return_inverse=True)
        of_reference = rng.standard_normal((owner.max() + 1, NOISES))[owner]
        noise = np.sqrt(0.5) * (noise + of_reference)
    geometry = rng.standard_normal((problem.slopes.shape[1], NOISES))
    return np.asarray(noise + problem.slopes @ geometry)


def variants(effect: Effect, state: State) -> dict[str, Effect]:
    """The effect, and it without each kind of the columns that adapt it."""
    constants = effect.constant_grid()[0]
    shapes = [c.name for c in effect.columns(state, **constants) if c.shape]
    kinds = dict.fromkeys(name.split()[-1] for name in shapes)
    return {"whole": effect} | {f"without {k}": _without(effect, k) for k in kinds}


def _without(effect: Effect, kind: str) -> Effect:
    def columns(state: State, **constants: float) -> Iterable[Column]:
        for column in effect.columns(state, **constants):
            if not (column.shape and column.name.split()[-1] == kind):
                yield column

    return dataclasses.replace(effect, columns=columns)


def _cases(
    options: argparse.Namespace,
) -> Iterator[tuple[str, ChangedReadings]]:
    generator = Generator(options.generator)
    for k in range(options.cases):
        machine = MACHINES[k % len(MACHINES)]
        seed = options.seed + k // len(MACHINES)
        yield "second", second_case(generator, machine, options.effect, seed)
    for k in range(options.cases):
        yield "third", third_case(options.effect, options.seed + k)


def table(means: Mapping[tuple[str, str], list[float]]) -> list[str]:
    """Means by source and variant, with their standard errors."""
    lines = ["| source | form | log Bayes factor | n |", "|---|---|---|---|"]
    for (source, form), values in means.items():
        error = np.std(values) / np.sqrt(len(values))
        words = f"{np.mean(values):.1f} ± {error:.1f}"
        lines.append(f"| {source} | {form} | {words} | {len(values)} |")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 2 bad input."""
    options = _parser().parse_args(arguments)
    by_form: dict[tuple[str, str], list[float]] = collections.defaultdict(list)
    try:
        for source, case in _cases(options):
            named = [
                e for e in case.effects if e.name == (options.tried or options.effect)
            ]
            if not named:
                raise ValueError(f"--effect {options.effect}: the library has none")
            for form, effect in variants(named[-1], case.problem.states[0]).items():
                by_form[source, form].append(log_factor(case, effect))
    except ModuleNotFoundError as missing:
        print(f"skipped: the second generator is not there ({missing})")
        return 0
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(table(by_form)))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.second.forms", description=__doc__
    )
    parser.add_argument("--effect", required=True, help="that acts")
    parser.add_argument(
        "--tried", help="effect whose form is tried; the same by default"
    )
    parser.add_argument("--cases", type=int, default=12, help="of each source")
    parser.add_argument("--seed", type=int, default=3100)
    parser.add_argument("--generator", type=Path, default=case_files.GENERATOR)
    return parser


if __name__ == "__main__":
    sys.exit(main())
