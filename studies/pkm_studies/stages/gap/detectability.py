"""What the planned readings could find, and the runs that tell wanted effects apart, as
a section of the result.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import dataset, units
from oed.effect import Effect
from oed.gap.before import choose, detect, runs
from oed.gap.before.detection import Detectability, EffectRival
from oed.gap.before.pool import PairSeparation, Pool
from oed.gap.data import problem as problem_of
from oed.gap.data.problem import GapProblem
from oed.measurement import Measurement, Series
from oed.noise.law import stated
from oed.result import gap_before as result
from pkm_studies.resolve.gap_design import GapDesignRequest
from pkm_studies.stages.gap.sentences import listed, spoken

if TYPE_CHECKING:
    import pandas as pd

#: effects and pairs named in one sentence
MOST = 6


@dataclasses.dataclass(frozen=True)
class Before:
    """The section, and the readings of the chosen runs as a CSV to fill in."""

    section: result.GapBeforeSection
    poses_csv: str | None


def foresee(
    measurement: Measurement,
    series: Sequence[Series],
    covariates: pd.DataFrame,
    effects: Sequence[Effect],
    gravity: tuple[float, float, float],
    rng: np.random.Generator,
    designed: tuple[Measurement, GapDesignRequest] | None,
) -> Before:
    """What readings as planned could find of the effects; the runs of a [gap.design]
    with a measurement of its set-ups.

    The noise is that stated: what real runs add to it is not known before there are
    any.
    """
    planned = problem_of.assemble(measurement, series, covariates, gravity=gravity)
    chosen, csv = None, None
    if designed is not None:
        chosen, csv = _chosen(*designed, planned, effects, gravity, rng)
    fine = _fine(measurement) | (_fine(designed[0]) if designed is not None else {})
    made = result.GapBeforeSection(
        _table(planned, effects, rng, fine), fine, chosen, []
    )
    return Before(result.GapBeforeSection(made.table, fine, chosen, _words(made)), csv)


def _fine(measurement: Measurement) -> dict[str, str]:
    """Fine unit of each channel."""
    return {
        c.name: units.FINE[c.unit]
        for s in measurement.setups.values()
        for c in s.instrument.channels
    }


# -- the table -------------------------------------------------------------------------


def _table(
    planned: GapProblem,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    fine: Mapping[str, str],
) -> result.DetectabilityTable:
    found = detect.detect(planned, stated(planned), effects, rng)
    about = {e.name: e.about for e in effects}
    return result.DetectabilityTable(
        readings=len(planned),
        effects=[_row(row, about[row.effect], fine) for row in found.effects],
        names=list(found.names),
        separation=found.separation.tolist(),
        angles_deg=found.angles.tolist(),
        classes=[list(c) for c in found.classes],
        absorbed=[list(pair) for pair in found.absorbed],
        exact=[list(pair) for pair in found.exact],
    )


def _row(
    row: Detectability, about: str, fine: Mapping[str, str]
) -> result.DetectabilityRecord:
    return result.DetectabilityRecord(
        name=row.effect,
        about=about,
        columns=row.columns,
        detectability=row.detectability,
        low=row.low,
        high=row.high,
        power=row.power,
        visible=row.visible,
        signature={n: v / units.factor(fine[n]) for n, v in row.signature.items()},
        absorbed=row.absorbed,
        least={n: _known(v / units.factor(fine[n])) for n, v in row.least.items()},
        median={n: _known(v / units.factor(fine[n])) for n, v in row.median.items()},
        sizes={n: _known(v) for n, v in row.sizes.items()},
        rivals=[_rival(r) for r in row.rivals],
        not_testable=row.not_testable,
    )


def _rival(rival: EffectRival) -> result.RivalRecord:
    shared = [
        result.SharedRecord(
            s.words, dict(s.combination), s.detectability, s.separation, s.angle
        )
        for s in rival.shared
    ]
    return result.RivalRecord(rival.name, rival.separation, rival.angle, shared)


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) and value < 1e6 else None


# -- the chosen runs -------------------------------------------------------------------


def _chosen(
    measurement: Measurement,
    asked: GapDesignRequest,
    planned: GapProblem,
    effects: Sequence[Effect],
    gravity: tuple[float, float, float],
    rng: np.random.Generator,
) -> tuple[result.ChosenRuns, str]:
    assert asked.rules is not None  # a plan that is followed is made by now
    problem, rows = runs.prepare(measurement, asked.runs, gravity=gravity)
    kept = np.array(asked.kept, dtype=np.intp)
    try:
        pool = Pool(problem, stated(problem), rows, asked.wanted, asked.rivals)
        found = choose.choose(
            pool,
            asked.rules,
            rng,
            share=asked.said.share,
            fixed=kept,
            rounds=asked.said.starts,
        )
    except ValueError as error:
        remedy = "give conditions that show it, or other effects or rules"
        raise asked.place.error(str(error), remedy) from error
    before = _before(planned, asked)
    taken = [asked.runs[k] for k in found.runs]
    series, covariates = runs.lay_out(measurement, taken)
    timed = (
        covariates
        if "time" in covariates
        else covariates.assign(time=_clock(covariates, asked))
    )
    own = problem_of.assemble(measurement, series, timed, gravity=gravity)
    told = [
        result.SeparationRecord(
            t.effect,
            t.rival,
            t.words,
            t.detectability,
            t.separation,
            before.get(_key(t)),
        )
        for t in found.pairs
    ]
    worst = [t.before for t in told]
    made = result.ChosenRuns(
        candidates=len(asked.runs) - len(asked.kept),
        retained=len(asked.kept),
        runs=[
            result.ChosenRun(r.setup, r.name, dict(r.condition), r.seconds)
            for r in taken
        ],
        separation=found.separation,
        bound=found.bound,
        before=(
            None
            if not worst or None in worst
            else min(w for w in worst if w is not None)
        ),
        efficiency=found.efficiency,
        proven=found.proven,
        share=asked.said.share,
        volume=found.volume,
        seconds=found.seconds,
        separations=told,
        table=_table(own, effects, rng, _fine(measurement)),
    )
    return made, _csv(measurement, series, covariates)


def _clock(covariates: pd.DataFrame, asked: GapDesignRequest) -> np.ndarray:
    """Time of each reading (n,) where the runs are taken one after the other, s."""
    seconds = {(r.setup, r.name): r.seconds for r in asked.runs}
    names, cost = (
        dict.fromkeys(r.setup for r in asked.runs),
        None if asked.rules is None else asked.rules.setup_cost,
    )
    mounting = (
        dict.fromkeys(names, 0.0)
        if cost is None
        else dict(zip(names, cost.tolist(), strict=True))
    )
    clock, mounted, times = 0.0, "", []
    for (setup, name), rows in covariates.groupby(["setup", "run"], sort=False):
        clock += mounting[setup] if setup != mounted else 0.0
        mounted = setup
        times.append(
            clock + seconds[setup, name] * np.arange(1, len(rows) + 1) / len(rows)
        )
        clock += seconds[setup, name]
    return np.concatenate(times)


def _key(told: PairSeparation) -> tuple[str, str, str]:
    return told.effect, told.rival, told.words


def _before(
    planned: GapProblem, asked: GapDesignRequest
) -> dict[tuple[str, str, str], float]:
    """What the readings planned otherwise tell of the same pairs; nothing where they
    cannot test the effects.
    """
    try:
        pool = Pool(
            planned, stated(planned), planned.blocks, asked.wanted, asked.rivals
        )
    except ValueError:
        return {}
    return {
        _key(t): t.separation
        for t in pool.pair_separations(np.arange(len(planned.blocks)))
    }


def _csv(
    measurement: Measurement, series: Sequence[Series], covariates: pd.DataFrame
) -> str:
    """The chosen runs as a readings file with empty readings."""
    beside = covariates.drop(columns=["setup", "run", "order"]).assign(
        time=np.nan
    )  # to be written down with each
    empty = np.full(len(measurement.owners(series)), np.nan)
    return dataset.to_csv(dataset.from_series(series, empty, measurement, beside))


# -- words -----------------------------------------------------------------------------


def _words(made: result.GapBeforeSection) -> list[str]:
    table = made.table if made.chosen is None else made.chosen.table
    who = "The planned readings" if made.chosen is None else "The chosen runs"
    told = _design_words(made.chosen) if made.chosen is not None else []
    seen = [e for e in table.effects if e.visible]
    blind = [e for e in table.effects if not e.visible and e.not_testable is None]
    told.append(
        f"{who} find {len(seen)} of the {len(table.names)} effects that they can test,"
        " at the expected sizes (90 % chance at 1 % false"
        f" alarm){_names(blind, '; too small for them: ')}."
    )
    for name in list(dict.fromkeys(k for k, _ in table.absorbed))[:MOST]:
        rivals = [spoken(j) for k, j in table.absorbed if k == name]
        told.append(
            f"{_first(spoken(name))} could also be explained by {listed(rivals, 'or')}."
        )
    for pair in table.exact[:MOST]:
        told.append(
            "The same to these readings in part, whatever their size:"
            f" {' and '.join(map(spoken, pair))}."
        )
    missing = [e for e in table.effects if e.not_testable is not None]
    if missing:
        told.append(
            f"Not testable by them: {listed([spoken(e.name) for e in missing])}."
        )
    return told


def _design_words(chosen: result.ChosenRuns) -> list[str]:
    pairs = sorted(
        {
            " and ".join(sorted((spoken(t.effect), spoken(t.rival))))
            for t in chosen.separations
        }
    )
    share = (
        "no plan is better" if chosen.proven else f"no plan exceeds {chosen.bound:.1f}"
    )
    before = "" if chosen.before is None else f" from {chosen.before:.1f}"
    kept = f", beside {chosen.retained} kept ones," if chosen.retained else ""
    return [
        f"{len(chosen.runs) - chosen.retained} of {chosen.candidates} candidate runs{kept}"
        f" raise the least distinguishability of {'; '.join(pairs[:MOST])}{before} to"
        f" {chosen.separation:.1f} ({share})."
    ]


def _first(text: str) -> str:
    return text[:1].upper() + text[1:]


def _names(effects: Sequence[result.DetectabilityRecord], lead: str) -> str:
    return lead + listed([spoken(e.name) for e in effects]) if effects else ""
