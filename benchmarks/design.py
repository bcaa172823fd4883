"""Design of experiments beside other packages and solvers: value, bound and time.

    python benchmarks/design.py                              # this project and general solvers
    python benchmarks/design.py --install-peers DIR          # one environment for each other package, in DIR
    python benchmarks/design.py --peers DIR [--markdown FILE]
    python benchmarks/design.py --relaxations                # each relaxation, cvxpy, studies' candidates

Problem A is in `peers.py`, with the other packages' adapters. Values are
computed here, from the rows that a package returns. Seconds are processor time on one
thread, of the choice alone, without imports: medians of three runs for this project,
one run for the others. A ratio is to this project's best row of the problem.
docs/benchmarks/design.md has the best row of each package.

Problems C0 to C2 (`hexapod.py`, three instances) choose 10 of 2000 poses of a hexapod
with 42 parameters by D, without a prior. A pose gives six correlated readings. The 60
readings for 42 unknowns leave 10 to 13 % between plan and bound. More rounds and wider
pools do not find a better plan, and branching lowers the bound. The packages' row
exchanges take no blocks, so only cvxpy is compared. Its columns are transformed so that
equal weights give the identity: Clarabel fails on the original columns.
"""

from __future__ import annotations

import os

THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "RAYON_NUM_THREADS",
)
for _name in THREADS:
    os.environ[_name] = "1"  # before NumPy is loaded

import argparse
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import cvxpy as cp
import numpy as np

import design_relaxations
import hexapod
import peer_runs
from design_table import Row, format_markdown, format_text, sort
from oed.design import branch, condition, exchange, relaxation
from oed.design.blocks import block_array, information
from peers import COLUMNS, PEERS, SIZE, candidates, processor_seconds, value

RELAXED_D, EXACT_D, RELAXED_E = "A, D relaxed", "A, D", "A, E relaxed"
RELAXED_POSES, POSES = "C0, D relaxed", ("C0, D", "C1, D", "C2, D")
SOLVERS = ("SCS", "CLARABEL")

Result = TypeVar("Result")


def time_median(work: Callable[[], Result], repeats: int = 3) -> tuple[float, Result]:
    """Median processor seconds, and the result of the last run."""
    times = []
    for _ in range(repeats):
        start = processor_seconds()
        result = work()
        times.append(processor_seconds() - start)
    return statistics.median(times), result


# -- this project ----------------------------------------------------------------------


def relax(rows: np.ndarray, size: int = SIZE, problem: str = RELAXED_D) -> Row:
    """Relaxed D: the value at the optimal weights, and its certified bound."""
    seconds, optimum = time_median(lambda: relaxation.relax(rows, size))
    # log phi is a mean over the columns
    columns = rows.shape[-1]
    reached, bound = columns * optimum.value, columns * optimum.bound
    note = f"duality gap {abs(bound - reached):.0e}"
    return Row(problem, "this project", reached, seconds, bound, note, True)


def relax_e(rows: np.ndarray) -> Row:
    """Relaxed least eigenvalue, its bound checked at the repaired dual."""
    seconds, optimum = time_median(lambda: condition.e_optimal(rows, SIZE), 1)
    return Row(
        RELAXED_E, "this project", optimum.value, seconds, optimum.bound, ours=True
    )


def choose_greedily(rows: np.ndarray) -> Row:
    """Greedy choice by D."""
    nothing_known = np.zeros((COLUMNS, COLUMNS))
    seconds, indices = time_median(
        lambda: exchange.greedy_d(block_array(rows), SIZE, nothing_known)
    )
    reached = value(EXACT_D, indices)[0]
    return Row(EXACT_D, "this project, greedy", reached, seconds, ours=True)


def choose_rows(rows: np.ndarray, criterion: str, rounds: int) -> Row:
    """This project's choice, with its bound where it comes at no cost."""

    def work() -> exchange.Choice:
        rng = np.random.default_rng(1)
        return exchange.choose(rows, SIZE, rng, criterion, rounds=rounds, certify=False)

    seconds, choice = time_median(work)
    problem = f"A, {criterion}"
    reached = value(problem, choice.indices)[0]
    note = "" if choice.efficiency is None else _certified(choice.efficiency)
    method = f"this project, {rounds} rounds"
    return Row(problem, method, reached, seconds, choice.bound, note, True)


def choose_poses(instance: int, rounds: int) -> Row:
    """This project's choice of poses."""
    blocks = hexapod.blocks(instance)

    def work() -> exchange.Choice:
        rng = np.random.default_rng(1)
        return exchange.choose(blocks, hexapod.SIZE, rng, rounds=rounds, certify=False)

    seconds, choice = time_median(work)
    reached = hexapod.log_det(blocks, choice.indices)
    note = "" if choice.efficiency is None else _certified(choice.efficiency)
    method = f"this project, {rounds} rounds"
    return Row(POSES[instance], method, reached, seconds, choice.bound, note, True)


def branch_poses(instance: int, nodes: int) -> Row:
    """The same choice, with a bound that branching lowers."""
    blocks = hexapod.blocks(instance)

    def work() -> branch.BranchResult:
        rng = np.random.default_rng(1)
        return branch.solve(blocks, hexapod.SIZE, rng, nodes=nodes)

    seconds, result = time_median(work, 1)
    reached = hexapod.log_det(blocks, result.indices)
    bound = hexapod.COLUMNS * result.bound
    note = _certified(float(np.exp(result.value - result.bound)))
    method = f"this project, {nodes} nodes of a tree"
    return Row(POSES[instance], method, reached, seconds, bound, note, True)


def _certified(efficiency: float) -> str:
    return f"certified {100 * efficiency:.1f} % efficient"


# -- general solvers -------------------------------------------------------------------


def solve(rows: np.ndarray, size: int, problem: str, solver: str, limit: float) -> Row:
    """The same relaxation by a general convex solver; it gives no certificate."""
    blocks = block_array(rows)
    count = len(blocks)
    at_equal_weights = information(blocks, np.full(count, size / count))
    whitened = blocks @ np.linalg.inv(np.linalg.cholesky(at_equal_weights)).T
    seconds, weights = time_median(
        lambda: _solve_by_cvxpy(whitened, size, solver, limit), 1
    )
    method = f"cvxpy + {solver}"
    if weights is None:
        return Row(problem, method, note=f"no answer within {limit:.0f} s")
    weights = np.clip(weights, 0.0, 1.0)
    weights *= size / weights.sum()
    reached = float(np.linalg.slogdet(information(blocks, weights))[1])
    return Row(problem, method, reached, seconds)


def _solve_by_cvxpy(
    blocks: np.ndarray, size: int, solver: str, limit: float
) -> np.ndarray | None:
    count, _, columns = blocks.shape
    weights = cp.Variable(count, nonneg=True)
    # one sparse product: far quicker to compile than a sum of matrices or diag(w)
    products = (np.swapaxes(blocks, 1, 2) @ blocks).reshape(count, -1)
    m = cp.reshape(products.T @ weights, (columns, columns), order="C")
    limits = [cp.sum(weights) == size, weights <= 1]
    problem = cp.Problem(cp.Maximize(cp.log_det(m)), limits)
    limit_name = "time_limit" if solver == "CLARABEL" else "time_limit_secs"
    try:
        problem.solve(solver=solver, **{limit_name: limit})
    except cp.SolverError:
        return None
    return weights.value


# -- the table -------------------------------------------------------------------------


def run_problem_a(rows: np.ndarray, limit: float) -> list[Row]:
    """Problem A by this project and general solvers."""
    return [
        relax(rows),
        *(solve(rows, SIZE, RELAXED_D, name, limit) for name in SOLVERS),
        choose_rows(rows, "D", 5),
        choose_rows(rows, "D", 20),
        choose_greedily(rows),
        relax_e(rows),
        choose_rows(rows, "E", 3),
        choose_rows(rows, "E", 20),
    ]


def run_problem_c(limit: float) -> list[Row]:
    """Problem C by this project and general solvers."""
    blocks = hexapod.blocks(0)
    return [
        relax(blocks, hexapod.SIZE, RELAXED_POSES),
        *(solve(blocks, hexapod.SIZE, RELAXED_POSES, name, limit) for name in SOLVERS),
        *(choose_poses(instance, 20) for instance in range(len(POSES))),
        branch_poses(1, 30),
    ]


def parse_arguments() -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--peers", type=Path, metavar="DIR", help="folder of the environments")
    add("--install-peers", type=Path, metavar="DIR", help="create them, and stop")
    add("--only", nargs="*", default=[], choices=PEERS, help="packages")
    add("--timeout", type=float, default=120.0, help="seconds for one task or solver")
    add("--markdown", type=Path, metavar="FILE", help="write the best rows there too")
    add("--relaxations", action="store_true", help="each relaxation beside cvxpy")
    return parser.parse_args()


def run(arguments: argparse.Namespace) -> list[Row]:
    """The rows that the command line asks for."""
    relaxation.relax(candidates(), SIZE)  # warm-up
    if arguments.relaxations:
        return design_relaxations.run_relaxations()
    rows = run_problem_a(candidates(), arguments.timeout)
    rows += run_problem_c(arguments.timeout)
    if arguments.peers is None:
        advice = "name their folder with --peers, created by --install-peers"
        print(f"other packages skipped: {advice}", file=sys.stderr)
        return rows
    names = arguments.only or PEERS
    folder = arguments.peers.absolute()
    return rows + peer_runs.run_all(folder, arguments.timeout, names)


def main() -> None:
    """Print one table."""
    arguments = parse_arguments()
    if arguments.install_peers:
        names = arguments.only or PEERS
        peer_runs.install(arguments.install_peers.absolute(), names)
        return
    rows = sort(run(arguments))
    print(format_text(rows))
    if arguments.markdown:
        arguments.markdown.write_text(format_markdown(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
