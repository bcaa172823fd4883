"""Design of experiments beside other packages and solvers: value, bound and time.

    python -m benchmarks.design                      # this project and a general solver
    python -m benchmarks.design --install-peers DIR  # one environment for each package
    python -m benchmarks.design --peers DIR          # these packages as well
    python -m benchmarks.design --relaxations        # each relaxation, cvxpy, studies' candidates

Problem A is in `peers.py`, with the other packages' adapters. Values are computed here, from
the rows that a package returns. Seconds are processor time on one thread, of the choice
alone, without imports: medians of three runs for this project, one run for the others. Of
each other package the best row of a problem is printed.

Problem C0 (`hexapod.py`) chooses 10 of 2000 poses of a hexapod with 42 parameters by D,
without a prior. A pose gives six correlated readings. The 60 readings for 42 unknowns leave
10 to 13 % between plan and bound. The packages' row exchanges take no blocks, so only cvxpy
is compared. Its columns are transformed so that equal weights give the identity: Clarabel
fails on the original columns.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import cvxpy as cp
import numpy as np

from benchmarks import design_relaxations, hexapod, numpy_designs, peer_runs
from benchmarks.harness.tables import head, row
from benchmarks.peer_runs import Result
from benchmarks.peers import SIZE, candidates, processor_seconds, value
from oed.design import CRITERIA, condition, exchange, relaxation
from oed.design.blocks import information

#: variables that limit libraries to one thread
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "RAYON")
POSES, RELAXED_POSES = "C0, D", "C0, D relaxed"
OWN = "this project"
ROUNDS = 20  #: of its search
TIME_LIMIT_S = 120.0  #: seconds that a package or solver may take

Answer = TypeVar("Answer")


def time_median(work: Callable[[], Answer], repeats: int = 3) -> tuple[float, Answer]:
    """Median processor seconds, and the result of the last run."""
    times = []
    for _ in range(repeats):
        start = processor_seconds()
        result = work()
        times.append(processor_seconds() - start)
    return statistics.median(times), result


# -- this project ----------------------------------------------------------------------
def choose_rows(rows: np.ndarray, criterion: str) -> Result:
    """This project's choice, with its bound where it comes at no cost."""
    problem = f"A, {criterion}"
    seconds, choice = _chosen(rows, SIZE, criterion)
    reached = value(problem, choice.indices)[0]
    return _own(problem, reached, seconds, choice.bound)


def relax_e(rows: np.ndarray) -> Result:
    """Relaxed least eigenvalue, its bound checked at the repaired dual."""
    criterion = CRITERIA.build("E", rows.shape[1])
    seconds, optimum = time_median(lambda: condition.relax(criterion, rows, SIZE), 1)
    value, bound = np.exp([optimum.value, optimum.bound]).tolist()
    return _own("A, E relaxed", value, seconds, bound)


def choose_poses(blocks: np.ndarray) -> Result:
    """This project's choice of poses."""
    seconds, choice = _chosen(blocks, hexapod.SIZE, "D")
    reached = numpy_designs.log_det(blocks, choice.indices)
    return _own(POSES, reached, seconds, choice.bound)


def relax_poses(blocks: np.ndarray) -> Result:
    """Relaxed D: the value at the optimal weights, and its certified bound."""
    seconds, optimum = time_median(lambda: relaxation.relax(blocks, hexapod.SIZE))
    # log phi is a mean over the columns
    reached, bound = (blocks.shape[-1] * v for v in (optimum.value, optimum.bound))
    return _own(RELAXED_POSES, reached, seconds, bound)


def _chosen(
    rows: np.ndarray, size: int, criterion: str
) -> tuple[float, exchange.Choice]:
    def work() -> exchange.Choice:
        rng = np.random.default_rng(1)
        return exchange.choose(rows, size, rng, criterion, rounds=ROUNDS, certify=False)

    return time_median(work)


def _own(problem: str, value: float, seconds: float, bound: float | None) -> Result:
    return Result(problem, OWN, value, seconds, bound)


# -- a general solver ------------------------------------------------------------------
def solve_poses(blocks: np.ndarray) -> Result:
    """The relaxation of C0 by a general convex solver; it gives no certificate."""
    count, size = len(blocks), hexapod.SIZE
    at_equal_weights = information(blocks, np.full(count, size / count))
    whitened = blocks @ np.linalg.inv(np.linalg.cholesky(at_equal_weights)).T
    seconds, weights = time_median(lambda: _solve_by_clarabel(whitened, size), 1)
    method = "cvxpy + Clarabel"
    if weights is None:
        note = f"no answer within {TIME_LIMIT_S:.0f} s"
        return Result(RELAXED_POSES, method, note=note)
    weights = np.clip(weights, 0.0, 1.0)
    weights *= size / weights.sum()
    reached = float(np.linalg.slogdet(information(blocks, weights))[1])
    return Result(RELAXED_POSES, method, reached, seconds)


def _solve_by_clarabel(blocks: np.ndarray, size: int) -> np.ndarray | None:
    count, _, columns = blocks.shape
    weights = cp.Variable(count, nonneg=True)
    # one sparse product: far quicker to compile than a sum of matrices or diag(w)
    products = (np.swapaxes(blocks, 1, 2) @ blocks).reshape(count, -1)
    m = cp.reshape(products.T @ weights, (columns, columns), order="C")
    limits = [cp.sum(weights) == size, weights <= 1]
    problem = cp.Problem(cp.Maximize(cp.log_det(m)), limits)
    try:
        problem.solve(solver="CLARABEL", time_limit=TIME_LIMIT_S)
    except cp.SolverError:
        return None
    return weights.value


# -- the table -------------------------------------------------------------------------
def run(peers: Path | None) -> list[Result]:
    """Results of both problems; of other packages where their folder is named."""
    rows, blocks = candidates(), hexapod.blocks(0)
    relaxation.relax(rows, SIZE)  # warm-up
    results = [choose_rows(rows, "D"), choose_rows(rows, "E"), relax_e(rows)]
    results += [choose_poses(blocks), relax_poses(blocks), solve_poses(blocks)]
    if peers is None:
        advice = "name their folder with --peers, created by --install-peers"
        print(f"other packages skipped: {advice}", file=sys.stderr)
        return results
    return results + peer_runs.run_all(peers.absolute(), TIME_LIMIT_S)


def select_best(results: list[Result]) -> list[Result]:
    """Of each package the best result of a problem."""
    best: dict[tuple[str, str], Result] = {}
    for result in results:
        key = result.problem, result.method.split(",")[0]
        if key not in best or result.rank_value > best[key].rank_value:
            best[key] = result
    return sorted(best.values(), key=lambda result: result.problem)


def line(result: Result) -> str:
    """A line of the table."""
    numbers = ((result.value, ".4f"), (result.seconds, ".3g"), (result.bound, ".4f"))
    cells = ["-" if number is None else format(number, f) for number, f in numbers]
    return row(result.problem, result.method, *cells, result.note or "-")


def main() -> None:
    """Print the table."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    add = parser.add_argument
    add("--peers", type=Path, metavar="DIR", help="folder of the environments")
    add("--install-peers", type=Path, metavar="DIR", help="create them, and stop")
    add("--relaxations", action="store_true", help="each relaxation beside cvxpy")
    arguments = parser.parse_args()
    os.environ.update(dict.fromkeys((f"{name}_NUM_THREADS" for name in THREADS), "1"))
    if arguments.install_peers:
        peer_runs.install(arguments.install_peers.absolute())
        return
    if arguments.relaxations:
        _print(design_relaxations.run_relaxations())
        return
    _print(select_best(run(arguments.peers)))


def _print(results: list[Result]) -> None:
    print(head("problem", "method", "value", "seconds", "bound", "note"))
    print("\n".join(map(line, results)))


if __name__ == "__main__":
    main()
