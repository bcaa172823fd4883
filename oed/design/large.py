"""Chooses candidates that do not fit in memory, with a certificate, in passes over a file.

1. The first pass gives the directions that the candidates determine, and a sample.
2. The relaxation over the sample gives gradient; the second pass finds the steepest candidates.
3. Plan and relaxation are computed over these. The third pass has the gradient of all
   candidates at that relaxation, and at the plan.

A line above the criterion bounds every plan, wherever it touches (`oed.design.objective`): the
bound holds for all candidates, however well the sample stood for them. Where candidates
outside would raise the relaxation by more than the tolerance, they join,
and the third pass is repeated.

Candidates stay on disk: NumPy files and memory-mapped arrays, and Arrow files. Rows are
read part by part as double precision. A part of a NumPy file is mapped alone, so that
the parts that were read before need no memory.
"""

from __future__ import annotations

import dataclasses
import importlib
import io
import mmap
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from oed.base import Array, Index
from oed.design import exchange
from oed.design.blocks import RANK_TOLERANCE, Spectrum, information, spectrum
from oed.design.bounds import bound
from oed.design.catalogue import CRITERIA
from oed.design.evaluator import CriterionEvaluator
from oed.design.exchange import Choice
from oed.design.forms import Criterion
from oed.design.objective import CriterionObjective, Tangent
from oed.design.relaxation import bound_by
from oed.design.rules import Rules
from oed.design.search import improve
from oed.design.whitening import Rounding, gamma


class CandidateFile(Protocol):
    """Whitened, scaled candidates on disk."""

    def __len__(self) -> int:
        """Number of candidates C."""
        ...

    def read(self, begin: int, end: int) -> Array:
        """Blocks (end - begin, k, n) of consecutive candidates."""
        ...

    def take(self, chosen: Index) -> Array:
        """Blocks (m, k, n) of the chosen candidates."""
        ...


class NumpyCandidates:
    """Rows (C, n) or blocks (C, k, n) of a .npy file, or of any memory-mapped array."""

    def __init__(self, source: Path | np.memmap[Any, Any]) -> None:
        """Raises ValueError where it holds something else."""
        mapped: Any = source
        if isinstance(source, Path):
            mapped = np.load(source, mmap_mode="r")
        self._mapped: Any = mapped
        floating = np.issubdtype(mapped.dtype, np.floating)
        if mapped.ndim not in (2, 3) or not floating or not mapped.flags.c_contiguous:
            raise ValueError(
                "candidates must be rows (C, n) or blocks (C, k, n) of floating-point"
                f" numbers in C order, not {mapped.dtype} of shape {mapped.shape}"
            )

    def __len__(self) -> int:
        """Number of candidates C."""
        return len(self._mapped)

    def read(self, begin: int, end: int) -> Array:
        """Blocks (end - begin, k, n) of consecutive candidates."""
        whole = self._mapped
        if not self._is_whole:
            return _as_double(whole[begin:end])
        shape = (end - begin, *whole.shape[1:])
        offset = whole.offset + begin * self._row_bytes
        return _as_double(np.memmap(whole.filename, whole.dtype, "r", offset, shape))

    def take(self, chosen: Index) -> Array:
        """Blocks (m, k, n) of the chosen candidates.

        They are read one by one: a mapping would have whole pages around each in memory.
        """
        whole = self._mapped
        if not self._is_whole:
            return _as_double(whole[chosen])
        with Path(whole.filename).open("rb", buffering=0) as file:
            rows = [self._row(file, int(number)) for number in chosen]
        numbers = np.frombuffer(b"".join(rows), whole.dtype)
        return _as_double(numbers.reshape(-1, *whole.shape[1:]))

    def _row(self, file: io.FileIO, number: int) -> bytes:
        """Bytes of one candidate."""
        file.seek(self._mapped.offset + number * self._row_bytes)
        return file.read(self._row_bytes)

    @property
    def _row_bytes(self) -> int:
        return int(self._mapped.itemsize * np.prod(self._mapped.shape[1:]))

    @property
    def _is_whole(self) -> bool:
        """Whether the array is that of its file; a slice has the offset of the whole."""
        base = getattr(self._mapped, "base", None)
        return isinstance(base, mmap.mmap) and self._mapped.filename is not None


class ArrowCandidates:
    """Rows (C, n) of an Arrow IPC file: one column a parameter, one row a candidate."""

    def __init__(self, path: Path) -> None:
        """Raises ValueError without pyarrow, and where a column is no number."""
        try:
            arrow = importlib.import_module("pyarrow")
        except ImportError:
            raise ValueError(
                "Arrow files need pyarrow: pip install pkm-oed[parquet], or write a .npy"
                " file"
            ) from None
        source = arrow.memory_map(str(path))
        self._table = (
            importlib.import_module("pyarrow.ipc").open_file(source).read_all()
        )
        for field in self._table.schema:
            if not arrow.types.is_floating(field.type):
                raise ValueError(
                    f"column {field.name} holds {field.type}, not floating-point numbers"
                )

    def __len__(self) -> int:
        """Number of candidates C."""
        return int(self._table.num_rows)

    def read(self, begin: int, end: int) -> Array:
        """Blocks (end - begin, 1, n) of consecutive candidates."""
        return self._blocks(self._table.slice(begin, end - begin))

    def take(self, chosen: Index) -> Array:
        """Blocks (m, 1, n) of the chosen candidates."""
        return self._blocks(self._table.take(chosen))

    @staticmethod
    def _blocks(part: Any) -> Array:
        columns = [column.to_numpy() for column in part.columns]
        return _as_double(np.column_stack(columns))


def open_candidates(path: Path | str) -> CandidateFile:
    """The candidates of a .npy file or of an Arrow IPC file (.arrow, .feather).

    Raises ValueError for another suffix or content, OSError where it cannot be read.
    """
    path = Path(path)
    try:
        if path.suffix == ".npy":
            return NumpyCandidates(path)
        if path.suffix in (".arrow", ".feather"):
            return ArrowCandidates(path)
        raise ValueError("candidates are read from .npy, .arrow and .feather files")
    except (EOFError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _as_double(rows: Any) -> Array:
    """Rows or blocks as blocks (m, k, n) of their own memory."""
    blocks = rows[:, None, :] if rows.ndim == 2 else rows
    return np.array(blocks, dtype=float, order="C")


#: number of candidates that are read at once: 17 MB of 21 columns
CANDIDATES_AT_ONCE = 100_000
#: number of candidates in the sample
SAMPLE_SIZE = 20_000
#: number of steepest candidates that go on
STEEPEST_SIZE = 20_000
#: number of repeats of the third pass, at the most
MAX_REPEATS = 5
#: gap in log phi between the relaxation and its bound that ends the repeats
GAP_TOLERANCE = 1e-7
#: a slope is rounded in its pass and in the bound: the allowance, in roundings of one
ROUNDED_GRADIENTS = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class _Survey:
    """What the first pass sees.

    of_all        singular values and directions of all rows and the prior
    column_sizes  (n,) largest size of a number of each column
    largest       candidates of the largest norm, and of the largest number of each column
    """

    of_all: Spectrum
    column_sizes: Array
    largest: Index


@dataclasses.dataclass(frozen=True, eq=False)
class _Coordinates:
    """Directions of the design, in which candidates have blocks X B.

    basis      (n, r) B; None for the columns themselves
    criterion  over the r directions
    base       (r, r) prior information
    rounding   of X B and of the prior
    """

    basis: Array | None
    criterion: Criterion
    base: Array
    rounding: Rounding

    def turn(self, blocks: Array) -> Array:
        """X B."""
        return blocks if self.basis is None else blocks @ self.basis


def choose_from_file(
    candidates: CandidateFile,
    size: int,
    rng: np.random.Generator,
    criterion: Criterion | str = "D",
    *,
    prior: Array | None = None,
    rounds: int = 20,
    tolerance: float = 1e-6,
) -> Choice:
    """Chooses different candidates of a file, as `choose` does of rows in memory.

    Raises ValueError as `choose`, for numbers that are not finite, and for a criterion
    that is not smooth and concave.
    """
    everything = len(candidates)
    if everything <= STEEPEST_SIZE:
        blocks = candidates.read(0, everything)
        return exchange.choose(
            blocks,
            size,
            rng,
            criterion,
            prior=prior,
            rounds=rounds,
            tolerance=tolerance,
        )
    survey = _survey(candidates, prior)
    columns = len(survey.column_sizes)
    goal = (
        CRITERIA.build(criterion, columns) if isinstance(criterion, str) else criterion
    )
    if not serves(goal):
        raise ValueError(
            f"{goal.name} needs its candidates in memory: a file serves the smooth criteria"
            f" ({', '.join(CRITERIA.smooth)})"
        )
    space = _coordinates(survey, goal, prior, tolerance)
    choice, upper, gap = _search(candidates, size, rng, space, survey, rounds)
    value = space.criterion.value(
        space.base + information(space.turn(candidates.take(choice.indices)))
    )
    choice = dataclasses.replace(
        choice,
        value=space.criterion.conventional_value(value, size),
        columns=columns,
        weak=survey.of_all.weak(tolerance),
    )
    return choice.add_bound(space.criterion, value, upper, gap)


def serves(criterion: Criterion | str) -> bool:
    """Whether a choice by the criterion can go through a file in passes."""
    goal = CRITERIA.build(criterion, 1) if isinstance(criterion, str) else criterion
    return goal.smooth and goal.concave


def _search(
    candidates: CandidateFile,
    size: int,
    rng: np.random.Generator,
    space: _Coordinates,
    survey: _Survey,
    rounds: int,
) -> tuple[Choice, float, float]:
    """The choice, still with the bound of a part; the bound of all, and its gap."""
    stride = max(1, len(candidates) // SAMPLE_SIZE)
    even = np.arange(0, len(candidates), stride)
    sample = np.union1d(even, survey.largest)
    root = _relaxed_root(space.turn(candidates.take(sample)), size, space)
    (steepest,) = _steepest(candidates, space, [root])
    working = np.union1d(steepest, survey.largest)
    blocks = space.turn(candidates.take(working))
    prior = space.base if space.base.any() else None
    choice = exchange.choose(
        blocks, size, rng, space.criterion, prior=prior, rounds=rounds, tolerance=0.0
    )
    plan = working[choice.indices]
    upper = np.inf
    for _ in range(MAX_REPEATS):
        relaxed = bound(blocks, space.criterion, Rules(size=size), space.base)
        m = space.base + information(blocks, relaxed.weights)
        chosen = np.searchsorted(working, plan)
        at_plan = space.base + information(blocks[chosen])
        roots = [space.criterion.support(x).root for x in (m, at_plan)]
        by_relaxation, by_plan = _steepest(candidates, space, roots)
        joined = np.union1d(np.union1d(working, by_relaxation), by_plan)
        weights = np.zeros(len(joined))
        weights[np.searchsorted(joined, working)] = relaxed.weights
        working, blocks = joined, space.turn(candidates.take(joined))
        tangent = _tangent(blocks, weights, space)
        upper = min(upper, bound_by(tangent, float(size), 1.0))
        chosen = np.searchsorted(working, plan)
        plan = working[_improved(blocks, chosen, size, space)]
        if upper - tangent.value < GAP_TOLERANCE:
            break
    choice = dataclasses.replace(choice, indices=np.sort(plan))
    return choice, upper, upper - tangent.value


def _improved(blocks: Array, chosen: Index, size: int, space: _Coordinates) -> Index:
    """The plan after exchanges for any of the blocks."""
    evaluator = CriterionEvaluator(blocks, space.criterion, space.base)
    return improve(evaluator, Rules(size=size), chosen, evaluator.levels - 1)


def _relaxed_root(blocks: Array, size: int, space: _Coordinates) -> Array:
    """Root of the supporting line at the relaxation over some candidates."""
    relaxed = bound(blocks, space.criterion, Rules(size=size), space.base)
    m = space.base + information(blocks, relaxed.weights)
    return space.criterion.support(m).root


def _tangent(blocks: Array, weights: Array, space: _Coordinates) -> Tangent:
    """The line at the weights, with the roundings of two gradient."""
    objective = CriterionObjective(space.criterion, blocks, space.base, space.rounding)
    active = np.flatnonzero(weights > 0)
    tangent = objective.tangent(active, weights[active])
    return dataclasses.replace(tangent, rounding=ROUNDED_GRADIENTS * tangent.rounding)


# -- passes ----------------------------------------------------------------------------


def _survey(candidates: CandidateFile, prior: Array | None) -> _Survey:
    """The first pass. Raises ValueError for numbers that are not finite."""
    triangle: Array | None = None
    sizes, largest = np.zeros(0), np.zeros(0, dtype=np.intp)
    for begin, blocks in _read(candidates):
        finite = np.isfinite(blocks).all(axis=(1, 2))
        if not finite.all():
            first_bad = (begin + np.flatnonzero(~finite)[:5]).tolist()
            raise ValueError(f"candidates number {first_bad} are not finite")
        rows = blocks.reshape(-1, blocks.shape[2])
        stacked = rows if triangle is None else np.vstack([triangle, rows])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
        norms = np.sqrt(np.einsum("ckn,ckn->c", blocks, blocks))
        by_candidate = np.column_stack([norms, np.abs(blocks).max(axis=1)])
        if not sizes.size:
            sizes = np.full(by_candidate.shape[1], -1.0)
            largest = np.zeros(len(sizes), dtype=np.intp)
        best = by_candidate.argmax(axis=0)
        here = by_candidate[best, np.arange(len(sizes))]
        largest = np.where(here > sizes, begin + best, largest)
        sizes = np.maximum(sizes, here)
    assert triangle is not None
    of_all = spectrum(triangle[:, None, :], prior)
    return _Survey(of_all, sizes[1:], np.unique(largest))


def _coordinates(
    survey: _Survey, goal: Criterion, prior: Array | None, tolerance: float
) -> _Coordinates:
    """Those of `choose`: the columns, orthonormal directions, or white ones for D."""
    of_all, n = survey.of_all, len(survey.column_sizes)
    white = goal.any_coordinates and of_all.is_ill_conditioned(tolerance)
    least = max(tolerance, RANK_TOLERANCE * n) if white else tolerance
    visible = of_all.visible(least)
    basis: Array = of_all.directions[:, visible]
    if white:
        basis = basis / of_all.values[visible]
    elif visible.all():
        base = np.zeros((n, n)) if prior is None else prior
        return _Coordinates(None, goal.restrict(np.eye(n)), base, Rounding())
    sizes = np.abs(basis)
    of_rows = gamma(n + 1) * float(np.linalg.norm(survey.column_sizes @ sizes))
    base, of_prior = np.zeros((basis.shape[1],) * 2), 0.0
    if prior is not None:
        base = basis.T @ prior @ basis
        base = 0.5 * (base + base.T)
        products = sizes.T @ np.abs(prior) @ sizes
        of_prior = gamma(2 * n + 2) * float(np.linalg.norm(products))
    return _Coordinates(basis, goal.restrict(basis), base, Rounding(of_rows, of_prior))


def _steepest(
    candidates: CandidateFile, space: _Coordinates, roots: list[Array]
) -> list[Index]:
    """The candidates of largest slope |X R|^2 for each root, in one pass."""
    best = [(np.zeros(0, dtype=np.intp), np.zeros(0)) for _ in roots]
    for begin, blocks in _read(candidates):
        turned = space.turn(blocks)
        for k, root in enumerate(roots):
            rows = turned.reshape(-1, turned.shape[2]) @ root
            by_row = np.einsum("ij,ij->i", rows, rows)
            gradient = by_row.reshape(-1, turned.shape[1]).sum(axis=1)
            best[k] = _merge(best[k], begin, gradient)
    return [np.sort(indices) for indices, _ in best]


def _merge(
    best: tuple[Index, Array], begin: int, gradient: Array
) -> tuple[Index, Array]:
    """The steepest of those before and of a part that begins at a candidate."""
    indices, before = best
    floor = before.min() if len(before) == STEEPEST_SIZE else -np.inf
    steep = np.flatnonzero(gradient > floor)
    indices = np.concatenate([indices, begin + steep])
    values = np.concatenate([before, gradient[steep]])
    if len(values) <= STEEPEST_SIZE:
        return indices, values
    places = np.argpartition(-values, STEEPEST_SIZE - 1)[:STEEPEST_SIZE]
    return indices[places], values[places]


def _read(candidates: CandidateFile) -> Iterator[tuple[int, Array]]:
    """Blocks (m, k, n) of all candidates, part by part, with the first one's number."""
    for begin in range(0, len(candidates), CANDIDATES_AT_ONCE):
        yield (
            begin,
            candidates.read(begin, min(begin + CANDIDATES_AT_ONCE, len(candidates))),
        )
