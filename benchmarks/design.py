"""Design of experiments: value, bound and time beside other packages and named solvers,
in one run on one thread.

    python benchmarks/design.py                              # this project and general solvers
    python benchmarks/design.py --install-peers DIR          # one environment for each other package, in DIR
    python benchmarks/design.py --peers DIR [--markdown FILE]
    python benchmarks/design.py --large                      # this project alone, up to 200,000 candidates, with memory

Problems A and B are in `peers/__init__.py`, the other packages' adapters beside it.
Values are computed here, from the rows or points that a package returns. Seconds are of
the processor, on one thread, of the choice alone, without imports: medians of three for
this project, one run for the others. A ratio is to this project's best row of the
problem. The table for a README holds the best row of each package, and what was
stopped.

Problems C0 to C2 (`hexapod.py`, three instances): 10 of 2000 poses of a hexapod with 42
parameters, six correlated readings a pose, no prior, D. Sixty readings for 42 unknowns
leave 10 to 13 % between plan and bound, from instance to instance: more rounds and
wider pools find no better plan, and branching lowers the bound. The packages' row
exchanges take no blocks, so cvxpy alone is beside it, with columns turned so that equal
weights give the unit matrix (as they come, Clarabel fails on them).
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
import dataclasses
import importlib
import json
import resource
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np

import hexapod
from oed.design import branch, condition, exchange, relaxation
from oed.design.blocks import as_blocks, information
from peers import BOUND_B, COLUMNS, FACTORS, SIZE, Task, busy, candidates, value

HERE = Path(__file__).resolve().parent
PEERS = sorted(path.stem for path in (HERE / "peers").glob("[a-z]*.py"))
RELAXED, EXACT_D, EXACT_E, FREE = "A, D relaxed", "A, D", "A, E", "B, D"
RELAXED_POSES, POSES = "C0, D relaxed", ("C0, D", "C1, D", "C2, D")
SOLVERS = ("SCS", "CLARABEL")


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table; `seconds` and `value` None where there is no result,
    `note` says why.
    """

    problem: str
    method: str
    value: float | None = None
    seconds: float | None = None
    bound: float | None = None
    note: str = ""
    ours: bool = False


def timed(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Median processor seconds, and what the last run returned."""
    times = []
    for _ in range(repeats):
        start = busy()
        found = work()
        times.append(busy() - start)
    return statistics.median(times), found


# -- this project ----------------------------------------------------------------------


def relaxed(rows: np.ndarray, size: int = SIZE, problem: str = RELAXED) -> Row:
    """Relaxed D: value at the weights, certified bound."""
    seconds, found = timed(lambda: relaxation.relax(rows, size))
    columns = rows.shape[-1]
    reached, above = (
        columns * found.value,
        columns * found.bound,
    )  # told as log phi, a mean over the directions
    return Row(
        problem,
        "this project",
        reached,
        seconds,
        above,
        f"gap {abs(above - reached):.0e}",
        True,
    )


def e_relaxed(rows: np.ndarray) -> Row:
    """The least eigenvalue's relaxation, its bound checked at the repaired dual."""
    seconds, found = timed(lambda: condition.e_optimal(rows, SIZE), 1)
    return Row(
        "A, E relaxed", "this project", found.value, seconds, found.bound, ours=True
    )


def greedy(rows: np.ndarray) -> Row:
    """Greedy choice."""
    seconds, found = timed(
        lambda: exchange.greedy_d(as_blocks(rows), SIZE, np.zeros((COLUMNS, COLUMNS)))
    )
    return Row(
        EXACT_D, "this project, greedy", value(EXACT_D, found)[0], seconds, ours=True
    )


def chosen(rows: np.ndarray, criterion: str, starts: int) -> Row:
    """Our choice, with its bound where it comes at no cost."""
    seconds, found = timed(
        lambda: exchange.choose(
            rows,
            SIZE,
            np.random.default_rng(1),
            criterion,
            starts=starts,
            certify=False,
        )
    )
    problem = f"A, {criterion}"
    note = (
        ""
        if found.efficiency is None
        else f"certified {100 * found.efficiency:.1f} % efficient"
    )
    reached = value(problem, found.indices)[0]
    return Row(
        problem,
        f"this project, {starts} rounds",
        reached,
        seconds,
        found.bound,
        note,
        True,
    )


def posed(instance: int, rounds: int) -> Row:
    """Our choice of poses."""
    blocks = hexapod.blocks(instance)
    seconds, found = timed(
        lambda: exchange.choose(
            blocks, hexapod.SIZE, np.random.default_rng(1), starts=rounds, certify=False
        )
    )
    reached, note = (
        hexapod.log_det(blocks, found.indices),
        f"certified {100 * found.efficiency:.1f} % efficient",
    )
    return Row(
        POSES[instance],
        f"this project, {rounds} rounds",
        reached,
        seconds,
        found.bound,
        note,
        True,
    )


def branched(instance: int, nodes: int) -> Row:
    """The same, with its bound lowered by branching."""
    blocks = hexapod.blocks(instance)
    seconds, found = timed(
        lambda: branch.solve(
            blocks, hexapod.SIZE, np.random.default_rng(1), nodes=nodes
        ),
        1,
    )
    reached, above = (
        hexapod.log_det(blocks, found.indices),
        hexapod.COLUMNS * found.bound,
    )
    note = f"certified {100 * np.exp(found.value - found.bound):.1f} % efficient"
    return Row(
        POSES[instance],
        f"this project, {nodes} nodes of a tree",
        reached,
        seconds,
        above,
        note,
        True,
    )


def placed(rounds: int) -> Row:
    """Our points in the box; the bound is from the literature, there is no own one for
    free points.
    """
    method = f"this project, 20 starts and {rounds} rounds"
    try:
        import casadi as ca

        from oed.design import continuous
    except ImportError:
        return Row(FREE, method, note="skipped: no oed.design.continuous", ours=True)
    v = ca.SX.sym("v", FACTORS)
    rows = ca.Function("rows", [v], [ca.horzcat(1.0, v.T)])
    ends = np.ones(FACTORS)
    seconds, found = timed(
        lambda: continuous.optimise(
            rows, -ends, ends, SIZE, np.random.default_rng(1), rounds=rounds
        )
    )
    reached, wrong = value(FREE, found.points)
    return Row(
        FREE,
        method,
        reached,
        seconds,
        float(BOUND_B),
        wrong or "bound: Ehlich 1964, Payne 1974",
        True,
    )


# -- general solvers -------------------------------------------------------------------


def solver(rows: np.ndarray, size: int, problem: str, name: str, limit: float) -> Row:
    """The same relaxation by a general convex solver; its objective is no certificate."""
    blocks = as_blocks(rows)
    count, columns = len(blocks), blocks.shape[2]
    equal = information(blocks, np.full(count, size / count))
    turned = blocks @ np.linalg.inv(np.linalg.cholesky(equal)).T
    options = (
        {"time_limit": limit} if name == "CLARABEL" else {"time_limit_secs": limit}
    )

    def work() -> np.ndarray | None:
        w = cp.Variable(count, nonneg=True)
        # one sparse product: far quicker to compile than a sum of matrices or diag(w)
        products = (np.swapaxes(turned, 1, 2) @ turned).reshape(count, -1)
        m = cp.reshape(products.T @ w, (columns, columns), order="C")
        goal = cp.Problem(cp.Maximize(cp.log_det(m)), [cp.sum(w) == size, w <= 1])
        try:
            goal.solve(solver=name, **options)
        except cp.SolverError:
            return None
        return w.value

    seconds, found = timed(work, 1)
    if found is None:
        return Row(problem, f"cvxpy + {name}", note=f"no answer within {limit:.0f} s")
    weights = np.clip(found, 0.0, 1.0)
    weights *= size / weights.sum()
    reached = float(np.linalg.slogdet(information(blocks, weights))[1])
    return Row(problem, f"cvxpy + {name}", reached, seconds)


# -- other packages --------------------------------------------------------------------


def interpreter(folder: Path, name: str) -> Path:
    """Python of a package's environment."""
    return folder / name / "bin" / "python"


def install(folder: Path, names: list[str]) -> None:
    """One environment for each package; what cannot be installed is told and left out."""
    uv = shutil.which(
        "uv",
        path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}",
    )
    for name in names:
        requires = importlib.import_module(f"peers.{name}").REQUIRES
        python = interpreter(folder, name)
        if uv:
            steps = [
                [
                    uv,
                    "venv",
                    "--quiet",
                    "--clear",
                    "--python",
                    sys.executable,
                    str(folder / name),
                ],
                [uv, "pip", "install", "--quiet", "--python", str(python), *requires],
            ]
        else:
            steps = [
                [sys.executable, "-m", "venv", "--clear", str(folder / name)],
                [str(python), "-m", "pip", "install", "--quiet", *requires],
            ]
        done = all(subprocess.run(step, check=False).returncode == 0 for step in steps)
        if not done:
            shutil.rmtree(folder / name, ignore_errors=True)
        print(
            f"{name:18s} {'installed' if done else 'could not be installed'}:"
            f" {' '.join(requires)}",
            flush=True,
        )


def peer(folder: Path, name: str, number: int, task: Task, limit: float) -> Row:
    """One task of one package, run in its environment."""
    package = name.replace("_", "-")
    method = f"{package}, {task.method}"
    python = interpreter(folder, name)
    if not python.exists():
        return Row(task.problem, method, note="skipped: not installed")
    try:
        # one at a time, so that nothing of it is left running beside the next
        ran = subprocess.run(
            [python, "-m", "peers", name, str(number)],
            cwd=HERE,
            capture_output=True,
            text=True,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        return Row(task.problem, method, note=f"stopped after {limit:.0f} s")
    if ran.returncode:
        why = (ran.stderr.strip().splitlines() or ["no word"])[-1]
        return Row(task.problem, method, note=f"failed: {why[:80]}")
    answer = json.loads(ran.stdout)
    reached, wrong = value(task.problem, answer["found"])
    note = "; ".join(part for part in (wrong, task.note) if part)
    return Row(
        task.problem,
        f"{package} {answer['version']}, {task.method}",
        reached,
        answer["seconds"],
        note=note,
    )


def peers(folder: Path, limit: float, names: list[str]) -> list[Row]:
    """All tasks of these packages."""
    found = []
    for name in names:
        for number, task in enumerate(importlib.import_module(f"peers.{name}").TASKS):
            found.append(peer(folder, name, number, task, limit))
            print(f"  {found[-1].method}", file=sys.stderr, flush=True)
    return found


# -- table -----------------------------------------------------------------------------


def arranged(rows: list[Row]) -> list[Row]:
    """By problem in order of appearance; this project first, the others by value."""
    order = list(dict.fromkeys(row.problem for row in rows))

    def rank(row: Row) -> tuple[int, bool, float]:
        return (
            order.index(row.problem),
            not row.ours,
            -np.inf if row.ours else -(row.value or -np.inf),
        )

    return sorted(rows, key=rank)


def best(rows: list[Row]) -> list[Row]:
    """This project's rows, the best one of each package, and what has no value (its
    version is not told).
    """
    kept: dict[tuple[str, str], Row] = {}
    for row in rows:
        key = row.problem, row.method if row.ours else row.method.split(",")[0]
        if key not in kept or (row.value or -np.inf) > (kept[key].value or -np.inf):
            kept[key] = row
    return [row for row in rows if any(row is other for other in kept.values())]


def cells(rows: list[Row]) -> list[list[str]]:
    """The table's text; the unit of the ratios is this project's best row of the
    problem.
    """
    unit: dict[str, Row] = {}
    for row in rows:
        if row.ours and row.value is not None:
            held = unit.setdefault(row.problem, row)
            unit[row.problem] = row if row.value > (held.value or 0.0) + 1e-9 else held
    text = []
    for row in rows:
        one = unit[row.problem].seconds if row.problem in unit else None
        times = 0.0 if row.seconds is None or one is None else row.seconds / one
        ratio = f"{times:.0f}" if times >= 10.0 else f"{times:.2g}" if times else "-"
        told = "-" if row.value is None else f"{row.value:.4f}"
        taken = "-" if row.seconds is None else f"{row.seconds:.3g}"
        above = "-" if row.bound is None else f"{row.bound:.4f}"
        text.append(
            [row.problem, row.method, told, taken, ratio, above, row.note or "-"]
        )
    return text


HEADER = ["problem", "method", "value", "seconds", "ratio", "bound", "note"]


def printed(text: list[list[str]]) -> str:
    """Aligned columns."""
    widths = [max(len(line[k]) for line in [HEADER, *text]) for k in range(len(HEADER))]
    return "\n".join(
        "  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip()
        for line in [HEADER, *text]
    )


def markdown(rows: list[Row]) -> str:
    """The best rows, without notes but where there is no value."""
    lines = [HEADER[:-1], ["---", "---", "--:", "--:", "--:", "--:"]]
    lines += [
        [*line[:2], line[-1] if line[2] == "-" else line[2], *line[3:-1]]
        for line in cells(best(rows))
    ]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def arguments() -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--peers",
        type=Path,
        metavar="DIR",
        help="folder of the other packages' environments",
    )
    parser.add_argument(
        "--install-peers",
        type=Path,
        metavar="DIR",
        help="make these environments, and stop",
    )
    parser.add_argument(
        "--only", nargs="*", default=[], choices=PEERS, help="these packages alone"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=120.0,
        help="seconds for one task of one package, or solver",
    )
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="write the best rows there too"
    )
    parser.add_argument(
        "--large",
        action="store_true",
        help="this project's relaxation with more candidates",
    )
    return parser.parse_args()


def poses(limit: float) -> list[Row]:
    """Problem C."""
    blocks = hexapod.blocks(0)
    found = [relaxed(blocks, hexapod.SIZE, RELAXED_POSES)]
    found += [
        solver(blocks, hexapod.SIZE, RELAXED_POSES, name, limit) for name in SOLVERS
    ]
    return [
        *found,
        *(posed(instance, 20) for instance in range(len(POSES))),
        branched(1, 30),
    ]


def main() -> None:
    """Print one table."""
    told = arguments()
    if told.install_peers:
        install(told.install_peers.absolute(), told.only or PEERS)
        return
    rows = candidates()
    relaxation.relax(rows, SIZE)  # warm-up
    found = [relaxed(rows)]
    if told.large:
        for count in (20_000, 200_000):
            row = relaxed(candidates(count))
            found.append(
                dataclasses.replace(row, method=f"this project, {count} candidates")
            )
    else:
        found += [solver(rows, SIZE, RELAXED, name, told.timeout) for name in SOLVERS]
        found += [chosen(rows, "D", 10), chosen(rows, "D", 100), greedy(rows)]
        found += [e_relaxed(rows), chosen(rows, "E", 3), chosen(rows, "E", 20)]
        found += [placed(0), placed(1000)]
        found += poses(told.timeout)
        if told.peers:
            found += peers(told.peers.absolute(), told.timeout, told.only or PEERS)
        else:
            print(
                "other packages skipped: name their folder with --peers, made by"
                " --install-peers",
                file=sys.stderr,
            )
    found = arranged(found)
    print(printed(cells(found)))
    if told.markdown:
        told.markdown.write_text(markdown(found), encoding="utf-8")
    if told.large:
        print(
            "peak memory"
            f" {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB"
        )


if __name__ == "__main__":
    main()
