"""Advises a second visit: its record in the result, its readings to fill in, its words."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed import units
from oed.gap import Diagnosis, Run, SecondVisit, propose_second_visit
from oed.result import ChosenRun, GapSection, SecondVisitRecord
from oed.text import format_probability, join_words
from pkm_studies.resolve import GapRequest
from pkm_studies.stages.gap.chosen_runs import poses_csv
from pkm_studies.stages.gap.words import plain_name

#: pairs of answers that are named, at most
MOST = 3
#: probability from which the visit is expected to decide
DECIDES = 0.8
#: gain in probability below which the visit is not worth its time
LEAST_GAIN = 0.02


@dataclasses.dataclass(frozen=True)
class VisitAdvice:
    """The record, and the readings to fill in as CSV."""

    record: SecondVisitRecord
    csv: str


def advise(
    diagnosis: Diagnosis,
    request: GapRequest,
    further: Sequence[Run],
    rng: np.random.Generator,
) -> VisitAdvice | None:
    """The second visit that a diagnosis calls for; None where none helps.

    `further` are runs that are possible beside those that were read.
    """
    conditions = request.conditions
    values = {
        "feed": [v * units.MM_PER_MIN for v in _values(conditions.feed_mm_min)],
        "payload": _values(conditions.payload),
    }
    effects = request.effects
    visit = propose_second_visit(diagnosis, effects, rng, values, further)
    if visit is None or visit.probability_after < visit.probability_now + LEAST_GAIN:
        return None
    measurement = diagnosis.problem.measurement
    csv = poses_csv(measurement, visit.series, visit.covariates)
    return VisitAdvice(_record(visit), csv)


def _values(stated: float | Sequence[float] | None) -> list[float]:
    """A condition's values, of which a table states one, several or none."""
    if stated is None:
        return []
    return list(stated) if isinstance(stated, Sequence) else [stated]


def add_visit(gap: GapSection, visit: SecondVisitRecord) -> GapSection:
    """The diagnosis with the visit, which stands first in its advice."""
    steps = [visit.words[0], *gap.next]
    return msgspec.structs.replace(gap, second_visit=visit, next=steps)


def _record(visit: SecondVisit) -> SecondVisitRecord:
    record = SecondVisitRecord(
        runs=[
            ChosenRun(run.setup, run.name, _untimed(run.condition), run.seconds)
            for run in visit.runs
        ],
        poses=[len(run.command) for run in visit.runs],
        probability_now=visit.probability_now,
        probability_after=visit.probability_after,
        separations=list(visit.pairs),
        inseparable=list(visit.inseparable),
    )
    return msgspec.structs.replace(record, words=sentences(record))


def _untimed(condition: Mapping[str, float]) -> dict[str, float]:
    """A condition without its time: the visit may be at any."""
    return {name: value for name, value in condition.items() if name != "time"}


def sentences(visit: SecondVisitRecord) -> list[str]:
    """What to read, what it is expected to decide, and what it cannot."""
    count, runs = sum(visit.poses), len(visit.runs)
    now, after = (
        format_probability(p) for p in (visit.probability_now, visit.probability_after)
    )
    sentences = [
        f"Take the {count} poses of second_visit.csv ({runs} run{'s' * (runs > 1)}) at a"
        " second visit. Expected probability that the likeliest cause is then the right"
        f" one: {after}; now it is {now}.",
        "The expectation is over what these readings leave possible, in the forms of the"
        " library: a cause of another form is not in it.",
    ]
    if visit.probability_after < DECIDES:
        sentences.append(
            "These runs alone will hardly decide: read what else separates the effects"
            " as well."
        )
    if visit.inseparable:
        pairs = [f"{_spoken(a)} from {_spoken(b)}" for a, b in visit.inseparable]
        sentences.append(
            "No run of those read so far separates"
            f" {join_words(pairs[:MOST], last='nor')}."
        )
    return sentences


def _spoken(answer: str) -> str:
    """An answer in words: its effects are joined by plus signs."""
    return join_words([plain_name(name) for name in answer.split(" + ")])
