"""Which mistakes readings cannot reveal: said before the measurement.

Each mistake is undone in noise-free readings of a machine that does not have it. Where
the result fits as well, readings with the mistake would as well. Of mistakes of an amount
it is the largest one that leaves no trace.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from oed.checks.fit import CANNOT_BE, fit
from oed.checks.mistakes import MistakeTrial, Suspect, trials
from oed.checks.screening import Screening
from oed.checks.session import SessionReadings
from oed.measurement import Measurement, draw_parameters

#: penalised sum of squares that noise-free readings may gain without a trace
MAX_GAIN = 25.0
#: kinds that rescale the noise, and show in it, or that need mistaken readings
SEEN_KINDS = ("unit", "deviation", "sorting", "disorder", "copied")
#: factors on readings, and on their noise, that a few readings do not tell
UNSEEN_FACTORS = (0.5, 2.0)
MAX_NAMED = 3  #: mistakes of a kind that a sentence names


def unseen_mistakes(
    session: SessionReadings, measurement: Measurement, rng: np.random.Generator
) -> list[str]:
    """Mistakes of the file and its set-ups, as sentences without a full stop, that would
    pass unnoticed; those of one kind together.

    measurement  the machine with all set-ups of the study
    """
    whole = dataclasses.replace(session, measurement=measurement)
    truth = draw_parameters(measurement, rng)
    exact = whole.with_y(measurement.readings(session.series, truth))
    plain = fit(exact)
    if plain is None:
        return []
    limit = plain.penalised + MAX_GAIN
    by_kind: dict[str, list[str]] = {}
    for trial in _trials(Suspect(exact, whole=True)):
        if _fits(exact, trial, limit):
            text = trial.text(trial.amounts, trial.amounts)
            by_kind.setdefault(trial.kind, []).append(text)
    return [_together(sentences) for sentences in by_kind.values()]


def _together(sentences: list[str]) -> str:
    """Mistakes of one kind, the first of them in words."""
    text = "; or ".join(sentences[:MAX_NAMED])
    more = len(sentences) - MAX_NAMED
    return f"{text}; or {more} others of this kind" if more > 0 else text


def _trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Mistakes of the file and of set-ups, without amounts, that may be unseen."""
    every = [t for t in trials(data) if _is_whole(t)]
    scores = Screening(data).scores(every)
    for trial, score in zip(every, scores, strict=True):
        if np.isfinite(score.log_evidence) and score.scale <= 100.0:
            yield trial


def _is_whole(trial: MistakeTrial) -> bool:
    """Whether a mistake concerns all readings of a set-up, and has one form."""
    if trial.kind in SEEN_KINDS or trial.scope.level not in ("file", "set-up"):
        return False
    has_form = not len(trial.amounts) and trial.estimated is None
    moves = trial.missing is None and trial.parts is None and trial.columns is None
    return has_form and moves and _is_of_noise(trial)


def _is_of_noise(trial: MistakeTrial) -> bool:
    """Whether a mistake leaves the readings with noise as stated, or nearly so."""
    if trial.mistaken is None or trial.y is None:
        return True
    count = max(int((trial.mistaken != trial.y).sum()), 1)
    factor = float(np.exp(-trial.log_scale / count))
    return min(UNSEEN_FACTORS) - 0.1 < factor < max(UNSEEN_FACTORS) + 0.1


def _fits(exact: SessionReadings, trial: MistakeTrial, limit: float) -> bool:
    """Whether readings with the mistake, or its inverse, differ and fit as well."""
    if trial.mistaken is not None:
        varied = exact.with_y(trial.mistaken)
    else:
        try:
            varied = trial.undo(trial.amounts)[0]
        except CANNOT_BE:
            return False
    if _same(varied, exact):
        return False
    solution = fit(varied)
    return solution is not None and solution.penalised <= limit


def _same(one: SessionReadings, other: SessionReadings) -> bool:
    if len(one.series) != len(other.series) or not np.array_equal(one.y, other.y):
        return False
    pairs = zip(one.series, other.series, strict=True)
    return all(a.setup == b.setup and np.array_equal(a.q, b.q) for a, b in pairs)
