"""Problem A of the design benchmark, and the adapters to other packages.

Call it in the folder `benchmarks`: `python -m peers NAME TASK`. It runs one task of one
package in that package's environment, and prints one line of JSON with `indices` (row
numbers), `seconds` (processor time of the choice alone) and `version`. Output of the
package itself goes to the error stream.

Only NumPy is imported here, because each package runs in an environment of its own.

Problem A: choose 30 different rows of the 2000 x 21 matrix
`numpy.random.default_rng(0).standard_normal((2000, 21))`. Maximise log det (D) or the
least eigenvalue (E) of their information matrix.

A task prepares what is not part of the choice: imports, and data in the package's format.
It returns the choice as a function, and only that function is timed.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import random
import re
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

SIZE, COLUMNS, CANDIDATES = 30, 21, 2000
#: least eigenvalue below which the information matrix counts as singular
SINGULAR = 1e-12

Choose = Callable[[], Any]


class Task(NamedTuple):
    """One method of one package for one problem."""

    problem: str  #: "A, D" or "A, E"
    method: str  #: description for the table
    prepare: Callable[
        [np.ndarray], Choose
    ]  #: takes the rows, returns the timed function
    note: str = ""  #: how its result differs from what the problem asks


class Peer(NamedTuple):
    """A package."""

    requires: tuple[str, ...]  #: pinned requirements, the package itself first
    tasks: tuple[Task, ...]  #: what it is asked to do


def processor_seconds() -> float:
    """Processor time of this process and of its finished children.

    Other processes on the machine do not count. On Windows, children do not either.
    """
    try:
        import resource
    except ImportError:
        return time.process_time()
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def candidates(count: int = CANDIDATES) -> np.ndarray:
    """Rows of problem A, (count, 21)."""
    return np.random.default_rng(0).standard_normal((count, COLUMNS))


def value(problem: str, indices: Sequence[Any] | np.ndarray) -> tuple[float, str]:
    """Criterion value of the chosen row numbers, and the rules they break, if any."""
    chosen = np.asarray(indices, dtype=int)
    matrix = candidates()[chosen]
    singular_values = np.linalg.svd(matrix, compute_uv=False)
    complete = len(singular_values) == COLUMNS
    least = float(singular_values[-1] ** 2) if complete else 0.0
    repeats = len(chosen) - len(set(chosen.tolist()))
    broken = [f"{repeats} repeated"] if repeats else []
    broken += [f"{len(chosen)} runs"] if len(chosen) != SIZE else []
    violations = ", ".join(broken)
    if problem.endswith("E"):
        return least, violations
    if least <= SINGULAR:
        return -np.inf, violations
    return 2.0 * float(np.log(singular_values).sum()), violations


def doekit_kl(rows: np.ndarray) -> Choose:
    """Its `kl_exchange` with its defaults, on a model matrix."""
    from doekit.generation.search.optimal import kl_exchange

    return lambda: kl_exchange(rows, SIZE, rng=np.random.default_rng(1))


def doekit_fedorov(rows: np.ndarray) -> Choose:
    """Its `fedorov_exchange` for the least eigenvalue, on a model matrix."""
    from doekit.domain.criteria import get_criterion
    from doekit.generation.search.optimal import fedorov_exchange

    return lambda: fedorov_exchange(
        rows, SIZE, get_criterion("E"), rng=np.random.default_rng(1)
    )


def doetools_fedorov(rows: np.ndarray) -> Choose:
    """Its `optimize_d_optimal` with its 50 random starts, on a whitened model matrix."""
    from doetools.design.d_opt.optimizer import optimize_d_optimal

    return lambda: optimize_d_optimal(
        rows, n_min=SIZE, n_max=SIZE, random_state=1
    ).best_indices[SIZE]


def figaroh_socp(rows: np.ndarray) -> Choose:
    """The 30 largest relaxed weights by picos and CVXOPT, on information matrices.

    The package itself takes every weight above 1e-5.
    """
    from figaroh.optimal.base_optimal_calibration import SOCPOptimizer

    pool = dict(enumerate(rows[:, :, None] * rows[:, None, :]))
    return lambda: list(SOCPOptimizer(pool, {"NbSample": len(rows)}).solve()[1])[:SIZE]


def figaroh_detmax(rows: np.ndarray) -> Choose:
    """Its exchange from one random start."""
    from figaroh.optimal.base_optimal_calibration import Detmax

    exchange = Detmax(dict(enumerate(rows[:, :, None] * rows[:, None, :])), SIZE)

    evaluate = exchange.get_critD
    current: list[int] = []

    # the class keeps its set in a local variable of `main_algo`: record it here
    def evaluate_and_record(chosen: list[int]) -> float:
        current[:] = chosen
        return evaluate(chosen)

    def choose() -> list[int]:
        exchange.get_critD = evaluate_and_record
        exchange.main_algo()
        return current

    return choose


def industrialstats_exchange(rows: np.ndarray) -> Choose:
    """Its `OptimalDesign`: row exchange, 5 random starts (it takes no seed)."""
    import pandas as pd
    from industrialstats.designs.base import Factor
    from industrialstats.designs.optimal import OptimalDesign

    names = [f"x{k}" for k in range(rows.shape[1])]
    factors = [Factor(name, [-5.0, 5.0], "continuous") for name in names]
    design = OptimalDesign(factors, SIZE, "D", model_terms=names)
    design.candidate_set = pd.DataFrame(rows, columns=names)
    numbers = {row.tobytes(): number for number, row in enumerate(rows)}

    def choose() -> list[int]:
        chosen = design.generate_design()[names].to_numpy(dtype=float)
        return [numbers[np.ascontiguousarray(row).tobytes()] for row in chosen]

    return choose


def optdesign_exchange(rows: np.ndarray) -> Choose:
    """Exchange of one row at a time, the best of 100 random orders."""
    from optdesign import opt_dmetric, setup_random

    def choose() -> np.ndarray:
        rng = np.random.default_rng(1)
        best_score, best = -np.inf, None
        for _ in range(100):
            order = np.asarray(setup_random(rows, rng))
            chosen = order[opt_dmetric(rows[order], SIZE, maxiter=1000)[:SIZE]]
            score = float(np.linalg.slogdet(rows[chosen].T @ rows[chosen])[1])
            if score > best_score:
                best_score, best = score, chosen
        return best

    return choose


def pydex_weights(rows: np.ndarray, criterion: str) -> Choose:
    """Weights by cvxpy, apportioned by Adams; `atomic_fims` are given, not derived."""
    from pydex.core.designer import Designer

    designer = Designer()
    designer.simulate = lambda ti_controls, model_parameters: np.array(
        [ti_controls @ model_parameters]
    )
    designer.ti_controls_candidates = rows
    designer.model_parameters = np.ones(rows.shape[1])
    designer.initialize(verbose=0)
    designer.sensitivities = rows[:, None, None, :]
    designer.atomic_fims = rows[:, :, None] * rows[:, None, :]
    designer._model_parameters_changed = designer._candidates_changed = False

    def choose() -> np.ndarray:
        goal = getattr(designer, f"{criterion}_opt_criterion")
        designer.design_experiment(goal, package="cvxpy", optimizer="CLARABEL")
        designer.apportion(SIZE, trimmed=False, compute_actual_efficiency=False)
        counts = np.zeros(len(rows), dtype=int)
        for candidate, runs in zip(
            designer.optimal_candidates, designer.apportionments, strict=True
        ):
            counts[candidate[0]] = int(np.nansum(runs))
        return np.repeat(np.arange(len(rows)), counts)

    return choose


def pydoe_jacobian(rows: np.ndarray, criterion: str) -> Choose:
    """Its `jacobian_optimal_design`: greedy, then exchange, with its defaults."""
    from pydoe import jacobian_optimal_design

    return lambda: jacobian_optimal_design(rows, SIZE, criterion=criterion)[0]


def pydoe3_optimal(rows: np.ndarray, criterion: str, method: str) -> Choose:
    """Its `optimal_design` of degree 1, with an intercept; rows are found by values."""
    from pyDOE3.doe_optimal import optimal_design

    numbers = {row.tobytes(): number for number, row in enumerate(rows)}

    def choose() -> list[int]:
        design, _ = optimal_design(rows, SIZE, 1, criterion=criterion, method=method)
        return [numbers[np.ascontiguousarray(row).tobytes()] for row in design]

    return choose


# -- all of them
ROUNDED = "may repeat rows; rounds the weights, no exchange"
REPEATED, INTERCEPT = "may repeat rows", "always adds an intercept"
PEERS = {
    "doekit": Peer(("doekit==0.9.1",), (
        Task("A, D", "KL exchange", doekit_kl),
        Task("A, E", "Fedorov exchange", doekit_fedorov),
    )),
    "doetools": Peer(("doetools==0.1.8",), (
        Task("A, D", "Fedorov exchange, 50 starts", doetools_fedorov, "D only"),
    )),
    "figaroh": Peer(("figaroh==1.0.2", "picos==2.6.2", "cvxopt==1.3.3"), (
        Task("A, D", "SOCP, 30 largest weights", figaroh_socp,
             "chooses how many itself; no exchange after the weights"),
        Task("A, D", "DETMAX", figaroh_detmax),
    )),
    "industrialstats": Peer(("industrialstats==0.3.0",), (
        Task("A, D", "row exchange, 5 starts", industrialstats_exchange,
             "may repeat rows; no E"),
    )),
    "optdesign": Peer(("optdesign==1.0.0",), (
        Task("A, D", "exchange, 100 starts", optdesign_exchange, "D only"),
    )),
    "pydex": Peer(("pydex==0.0.9", "cvxpy==1.9.3", "clarabel==0.11.1"), (
        Task("A, D", "Clarabel, apportioned", lambda r: pydex_weights(r, "d"), ROUNDED),
        Task("A, E", "Clarabel, apportioned", lambda r: pydex_weights(r, "e"), ROUNDED),
    )),
    "pydoe": Peer(("pydoe==1.6.0",), (
        Task("A, D", "greedy, exchange", lambda r: pydoe_jacobian(r, "D"), REPEATED),
        Task("A, E", "greedy, exchange", lambda r: pydoe_jacobian(r, "E"), REPEATED),
    )),
    "pydoe3": Peer(("pydoe3==1.6.2",), (
        Task("A, D", "greedy (its default)",
             lambda r: pydoe3_optimal(r, "D", "sequential"), INTERCEPT),
        Task("A, D", "DETMAX", lambda r: pydoe3_optimal(r, "D", "detmax"), INTERCEPT),
        Task("A, E", "DETMAX", lambda r: pydoe3_optimal(r, "E", "detmax"), INTERCEPT),
    )),
}  # fmt: skip


def main() -> None:
    """Run the task that the command line names, and print its answer."""
    name, number = sys.argv[1], int(sys.argv[2])
    answer_stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002 - packages that draw from the global generator
    peer = PEERS[name]
    choose = peer.tasks[number].prepare(candidates())
    start = processor_seconds()
    indices = choose()
    seconds = processor_seconds() - start
    package = re.split(r"[\[=<>]", peer.requires[0])[0]
    answer = {
        "indices": np.asarray(indices).tolist(),
        "seconds": seconds,
        "version": importlib.metadata.version(package),
    }
    json.dump(answer, answer_stream)
    answer_stream.close()
    os._exit(0)  # some packages leave threads behind


if __name__ == "__main__":
    main()
