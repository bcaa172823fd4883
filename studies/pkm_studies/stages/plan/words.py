"""A plan in words: why not another one, what would have to change, where to stop, what
a person reads on a terminal.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed import result
from oed.arrays import Array
from oed.design.criterion.protocol import inverse
from oed.planning import stage as staging
from oed.planning.option import Option
from oed.planning.search import Planned
from oed.planning.search import StagePlan as Found
from pkm_studies.stages.plan.plan import ANY, Task

#: plans tried without one of the plan's measurements, the most
LEFT_OUT = 4
#: share of lost readings from which it is worth telling
LOST = 0.05
#: beam of searches for what would be enough
NARROW = 2


def alternatives(
    task: Task, found: Planned, best: Found
) -> list[result.AlternativePlan]:
    """Other sequences, each with why it is not the plan: those found, and the best ones
    without each measurement.
    """
    seen = {best.names}
    made = []
    for option in [s.option for s in best.stages][:LEFT_OUT]:
        other = without(task, best, option)
        if other is not None and other.names not in seen:
            seen.add(other.names)
            made.append(
                task.way(other, f"without {option.name}: {why(task, other, best)}")
            )
    for other in found.alternatives:
        if other.names not in seen:
            seen.add(other.names)
            made.append(task.way(other, why(task, other, best)))
    return made


def without(task: Task, best: Found, option: Option) -> Found | None:
    """The same stages but one, with all the readings that the time then pays for; None
    where nothing is left.
    """
    steps = [s.option for s in best.stages if s.option is not option]
    if not steps:
        return None
    try:
        return task.search(
            best.seconds, options=steps, stages=len(steps), beam=NARROW, loss=ANY
        ).most_accurate
    except ValueError:  # the others' mountings alone take longer
        return None


def why(task: Task, other: Found, best: Found) -> str:
    """What speaks against another plan."""
    parts = []
    lost = [(1.0 - s.available.mean(), s.option.name) for s in other.stages]
    share, name = max(lost, default=(0.0, ""))
    if share > LOST and share > 2.0 * max(
        (1.0 - s.available.mean() for s in best.stages), default=0.0
    ):
        parts.append(
            f"a rough stage is missing: {percent(share)} of the readings of {name}"
            " would be lost"
        )
    if task.goal.wanted and other.value > 1.0:
        worst = int(np.argmax(task.goal.accuracy(task.left(other))))
        parts.append(
            f"reaches {_reached(task, task.left(other), task.goal.names[worst])}"
        )
        return "; ".join(parts)
    worse = other.value / best.value - 1.0
    time = _time(other.seconds, best.seconds)
    if worse > 1.0:
        parts.append(f"{worse + 1.0:.3g} times less accurate {time}")
    elif worse > 5e-4:
        parts.append(f"{percent(worse)} less accurate {time}")
    elif worse < -5e-4:
        parts.append(f"{better(best.value, other.value)} {time}")
    else:
        parts.append(f"as accurate {time}")
    return "; ".join(parts)


def needs(task: Task, found: Planned) -> list[str]:
    """What would have to change for the wanted accuracy; empty where it is reached."""
    if found.reached or not task.goal.wanted:
        return []
    told = [_proof(task, found), _ever(task)]
    try:
        double = task.search(2.0 * task.budget, beam=NARROW, loss=ANY).most_accurate
        told.append(
            _enough(
                task, double, f"twice the time ({2.0 * task.budget / 60.0:.0f} min)"
            )
        )
    except ValueError:
        pass
    finer = [_finer(o) for o in task.asked.options]
    told.append(
        _enough(
            task,
            task.search(options=finer, beam=NARROW, loss=ANY).most_accurate,
            "half the noise",
        )
    )
    return told


def _proof(task: Task, found: Planned) -> str:
    best = found.most_accurate
    text = (
        f"Out of reach in {task.budget / 60.0:.0f} min: the best plan found misses the"
        " worst component by a factor "
    )
    text += f"of {best.value:.3g}"
    if found.bound.value > 1.0:
        return (
            f"{text}, and no plan of these measurements gets below"
            f" {found.bound.value:.3g} (proven)."
        )
    return f"{text}; a better one is not excluded (bound {found.bound.value:.3g})."


def _ever(task: Task) -> str:
    """What all candidate readings together would leave: the limit of set-ups and
    instruments.
    """
    held = inverse(task.start)
    for option in task.asked.options:
        held = held + staging.information(
            option.candidates.blocks, np.ones(len(option.candidates)), len(held)
        )
    left = inverse(held)
    value = task.goal.value(left)
    if value > 1.0:
        return (
            "Even all readings of all measurements would miss it by a factor of"
            f" {value:.3g}: a set-up or an "
            + "instrument is needed that sees what these do not"
            f" ({_short(task, left)})."
        )
    return (
        f"All readings of all measurements together would reach it ({value:.3g} of what"
        " is wanted): time is short."
    )


def _enough(task: Task, plan: Found, what: str) -> str:
    reached = (
        "would do"
        if plan.value <= 1.0
        else f"would not do: a factor of {plan.value:.3g} is missing"
    )
    return f"{what.capitalize()} {reached} ({', '.join(plan.names)})."


def _finer(option: Option) -> Option:
    return dataclasses.replace(
        option,
        candidates=dataclasses.replace(
            option.candidates, blocks=2.0 * option.candidates.blocks
        ),
    )


def _short(task: Task, covariance: Array) -> str:
    share = task.goal.accuracy(covariance)
    return ", ".join(
        _reached(task, covariance, n)
        for n, v in zip(task.goal.names, share, strict=True)
        if v > 1.0
    )


def _reached(task: Task, covariance: Array, name: str) -> str:
    told = {
        k: v
        for k, v in task.accuracy(covariance).items()
        if k.rpartition("_")[0] == name
    }
    return ", ".join(
        f"{name} only to {v:.3g} {k.rpartition('_')[2]}" for k, v in told.items()
    )


def stop(task: Task, found: Planned, best: Found) -> str:
    """The next best stage, and what it would gain."""
    if best is not found.best:
        gain, names = (
            1.0 - found.best.value / best.value,
            ", then ".join(found.best.names),
        )
        told = (
            f"{len(found.best.stages)} stages ({names}) would leave errors"
            f" {percent(gain)} smaller"
        )
        return (
            f"after these {len(best.stages)}; {told}, less than the"
            f" {percent(task.said.worth)} that are worth it."
        )
    if found.next_gain is None:
        return "after the last stage; every measurement of the list is in the plan."
    name, gain = found.next_gain
    if gain < 5e-4:
        return (
            "after the last stage; no further measurement of the list helps (the next"
            f" best is {name})."
        )
    text = (
        f"after the last stage; a further one, {name}, would leave errors"
        f" {percent(gain)} smaller"
    )
    if gain < task.said.worth:
        return f"{text}, less than the {percent(task.said.worth)} that are worth it."
    option = task.asked.named(name)
    least = option.mounting + float(np.sort(option.seconds)[: option.counts[0]].sum())
    if task.budget - best.seconds >= least and len(best.stages) >= task.said.stages:
        return f"{text}, but the study allows {task.said.stages} stages."
    return f"{text}, were there time for it."


def percent(share: float) -> str:
    """A share in percent, with a digit where it is small."""
    return f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.1f} %"


def better(own: float, other: float) -> str:
    """How much more accurate than `own` another value is: a share, or from twice on a
    factor.
    """
    ratio = own / other
    if ratio >= 2.0:
        return f"{ratio:.3g} times as accurate"
    return f"{percent(ratio - 1.0)} more accurate"


def no_more(loss: float) -> str:
    """By how much a plan may be better that misses the best possible one by a share at
    the most.
    """
    return (
        f"{percent(loss)} better"
        if loss < 1.0
        else f"{loss + 1.0:.3g} times as accurate"
    )


def _time(one: float, other: float) -> str:
    if abs(one - other) < 0.02 * other:
        return "in the same time"
    return f"in {abs(one - other) / 60.0:.0f} min {'less' if one < other else 'more'}"


def sentences(section: result.PlanSection | None) -> Sequence[str]:
    """The plan as headline sentences; none where it was not searched for."""
    if section is None or section.value is None or not section.stages:
        return []
    names = ", then ".join(f"{s.measurement} ({s.chosen})" for s in section.stages)
    after = "; ".join(
        f"{k.rpartition('_')[0]} {v:.3g} {k.rpartition('_')[2]}"
        for k, v in section.accuracy.items()
    )
    told = [
        f"Plan of {section.cost:.0f} min: {names}; it leaves {after} rms over the"
        " workspace."
    ]
    if section.goal:
        told.append(
            "The wanted accuracy is reached."
            if section.reached
            else " ".join(section.needs)
        )
    if section.loss is not None:
        told.append(
            f"No plan within {section.budget_min:.0f} min is more than"
            f" {no_more(section.loss)} (bound)."
        )
    return told
