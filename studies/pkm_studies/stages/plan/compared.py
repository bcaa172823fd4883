"""A sequence of measurements that was asked for, with all readings of each, beside the
best plan of the same time.

Where all readings take longer than the budget, the best ones within it are taken:
sequences are then compared at equal time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed import criteria, explain, result
from oed.arrays import Array
from oed.planning import stage as staging
from oed.planning.known import Known
from oed.planning.search import Planned
from oed.planning.search import StagePlan as Found
from oed.planning.stage import Stage
from pkm_studies.errors import InputError
from pkm_studies.stages.plan.plan import ANY, Task
from pkm_studies.stages.plan.words import better, no_more

#: share by which times may differ and count as the same
SAME = 1e-6


def compared(task: Task, names: Sequence[str], found: Planned) -> result.SequenceRecord:
    """The sequence's ranks, indices, time and accuracy, and the best plan in its time.
    Raises InputError.
    """
    asked, time = taken(task, names), None
    if asked.seconds > task.budget * (1.0 + SAME):
        asked, time = _within(task, names, found), task.budget
    best, bound = _best(task, asked, found, asked.seconds if time is None else time)
    readings = [s for stage in asked.stages for s in stage.series]
    together = task.resolved.measurement_with({s.setup for s in readings})
    seen = explain.look(together, readings)
    s = seen.verdict.identifiable
    own, other = task.accuracy(task.left(asked)), task.accuracy(task.left(best))
    chosen = sum(len(stage.chosen) for stage in asked.stages)
    return result.SequenceRecord(
        name=", then ".join(names),
        sequence=task.way(asked),
        rank=seen.verdict.rank,
        parameters=len(seen.names),
        kappa=criteria.kappa(s),
        weakest=float(s[-1]),
        observability=criteria.observability(s, sum(len(x) for x in readings)),
        lost=float(sum((1.0 - stage.available).sum() for stage in asked.stages))
        / chosen,
        plan=task.way(best),
        gain={k: v / other[k] for k, v in own.items() if other.get(k, 0.0) > 0.0},
        bound=bound,
        words=_words(task, asked, best, bound, asked.seconds if time is None else time),
    )


def taken(task: Task, names: Sequence[str]) -> Found:
    """All candidates of each measurement, one after the other."""
    known: Array | Known = task.start
    stages: list[Stage] = []
    for k, name in enumerate(names):
        option = task.asked.named(name)
        rng = np.random.default_rng([*task.seed, k])
        stages.append(
            staging.told(option, np.arange(len(option.candidates)), known, rng)
        )
        known = stages[-1].known
    accuracy = tuple(
        task.goal.accuracy(c) for c in [task.start, *(s.covariance for s in stages)]
    )
    return Found(
        tuple(stages),
        sum(s.seconds for s in stages),
        task.goal.value(stages[-1].covariance),
        accuracy,
    )


def _within(task: Task, names: Sequence[str], found: Planned) -> Found:
    """The best plan of these measurements alone within the budget, where all their
    readings take longer.
    """
    options = [task.asked.named(n) for n in names]
    try:
        again = task.search(
            options=options, stages=len(options), loss=ANY
        ).most_accurate
    except ValueError as error:
        raise task.place.key("compare").error(
            str(error), "give more time, or compare others", list(names)
        ) from error
    known = [found.best, found.most_accurate, *found.alternatives]
    return min(
        [again, *(p for p in known if set(p.names) <= set(names))],
        key=lambda p: p.value,
    )


def _best(task: Task, asked: Found, found: Planned, time: float) -> tuple[Found, float]:
    """The most accurate plan found in the time of a sequence, which is one itself, and
    the bound.
    """
    if abs(time - task.budget) <= SAME * task.budget:
        best, bound = found.most_accurate, found.bound
    else:
        try:
            again = task.search(time * (1.0 + SAME))
        except ValueError as error:
            raise InputError(
                str(error), "compare a sequence that takes longer", field="plan.compare"
            ) from error
        best, bound = again.most_accurate, again.bound
    return min(best, asked, key=lambda p: p.value), bound.value


def _words(task: Task, asked: Found, best: Found, bound: float, seconds: float) -> str:
    time = f"{seconds / 60.0:.0f} min"
    if best is asked or asked.value < best.value * (1.0 + SAME):
        most = no_more(max(asked.value / bound - 1.0, 0.0))
        return f"No better plan of {time} was found; none is more than {most}."
    text = (
        f"In {time}, {', then '.join(best.names)} is {better(asked.value, best.value)}"
    )
    if task.goal.wanted and best.value > 1.0 and bound > 1.0:
        return (
            f"{text}; what is wanted is out of reach in that time (proven: {bound:.3g}"
            " times it is the least)."
        )
    most = no_more(max(best.value / bound - 1.0, 0.0))
    return f"{text}; no plan of that time is more than {most}."
