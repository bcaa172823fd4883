"""Each relaxation of this project beside cvxpy, on the candidates of three studies.

Values and bounds are log phi (for kappa, -log kappa). The conic forms are those of
`oed.design.conic`, in coordinates that suit the solver: an efficient use of cvxpy.
O4 has no conic form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.peer_runs import Result
from benchmarks.peers import processor_seconds
from benchmarks.study_candidates import StudyCandidates, of_studies
from oed.design import CRITERIA, condition, conic, relaxation
from oed.design.relaxation import Relaxation

SMOOTH = ("D", "A", "O5")


def run_relaxations() -> list[Result]:
    """Results of all studies and criteria."""
    results = []
    for study in of_studies():
        for name, own in _own_methods(study):
            problem = f"{study.name}, {name} relaxed"
            results.append(_result(problem, "this project", own))
            if name != "O4":
                results.append(
                    _result(problem, "cvxpy + Clarabel", _conic(study, name))
                )
    return results


def _own_methods(
    study: StudyCandidates,
) -> Iterator[tuple[str, Callable[[], Relaxation]]]:
    blocks, size = study.blocks, study.size
    columns = blocks.shape[2]
    for name in SMOOTH:
        criterion = CRITERIA.build(name, columns)
        yield name, lambda c=criterion: relaxation.relax(blocks, size, criterion=c)
    for name in ("E", "kappa", "O4"):
        criterion = CRITERIA.build(name, columns)
        yield name, lambda c=criterion: condition.relax(c, blocks, size)


def _conic(study: StudyCandidates, name: str) -> Callable[[], Relaxation]:
    criterion = CRITERIA.build(name, study.blocks.shape[2])
    return lambda: conic.relax(study.blocks, study.size, criterion)


def _result(problem: str, method: str, work: Callable[[], Relaxation]) -> Result:
    """Result of one run."""
    start = processor_seconds()
    try:
        optimum = work()
    except conic.NoConicAnswerError:
        seconds = processor_seconds() - start
        return Result(problem, method, None, seconds, note="no answer")
    seconds = processor_seconds() - start
    note = f"duality gap {optimum.duality_gap:.0e}"
    return Result(problem, method, optimum.value, seconds, optimum.bound, note)
