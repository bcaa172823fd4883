"""The design: choose readings from the candidates, polish and order them; what the plan
costs, condition numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import criteria, explain, result
from oed.arrays import Array
from oed.design import candidates
from oed.design.exchange import Choice
from oed.information import Scaling
from oed.measurement import Measurement, Series
from pkm_studies.errors import Place
from pkm_studies.resolve.grids import Circles
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.design import how_many, order, polish, robust, search
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.study.tables import DesignTable


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChosenDesign:
    """The plan, in working order, and how it was found.

    measurement  with the set-ups that it uses, as polished
    scheduled    the readings with the thermal references between
    kept         readings that belonged to the plan before
    candidates   that there were
    loose        whether the bound leaves the number of set-ups free
    compared     designs for further criteria
    """

    measurement: Measurement
    series: tuple[Series, ...]
    scheduled: tuple[Series, ...]
    choice: Choice
    aims: StudyCriteria
    kept: int
    candidates: int
    loose: bool
    compared: tuple[result.CriterionComparison, ...]
    polished: result.PolishSummary | None
    order: result.WorkingOrder
    robust: result.RobustSummary | None
    how_many: result.HowManySummary | None


def select_design(
    resolved: ResolvedStudy, rng: np.random.Generator
) -> ChosenDesign | None:
    """The best plan found, or None where the study asks for none. Raises InputError for
    what cannot be done.
    """
    design, asked = resolved.study.design, resolved.design
    if design is None or asked is None or not resolved.candidates:
        return None
    place, aims = resolved.study.place.key("design"), StudyCriteria(resolved, design)
    problem = _problem(resolved, design, aims, place)
    choice = _best(
        problem,
        aims,
        design.judged_by,
        rng,
        place.key("compound" if design.compound else "criterion"),
    )
    compared = _compared(problem, aims, choice, rng, place.key("compare"))
    sturdy, curve = None, None
    if design.robust is not None:
        choice, sturdy = robust.choose(
            problem, aims, choice, design.robust, rng, place.key("robust")
        )
    if design.how_many is not None:
        seed = resolved.study.seed
        curve = how_many.curve(
            problem, aims, choice, design.how_many, seed, place.key("how_many")
        )
    series = problem.candidates.readings_of(choice.indices)
    measurement = _mounted(resolved, [*asked.retained, *series])
    smoother = None
    if design.polish is not None and design.polish.enabled:
        smoother = polish.polished(resolved, aims, measurement, series, asked.retained)
        measurement, series = smoother.measurement, smoother.series
    arranged = order.arrange(resolved, measurement, asked.retained, series, rng)
    return ChosenDesign(
        measurement=measurement,
        series=arranged.series,
        scheduled=arranged.scheduled,
        choice=choice,
        aims=aims,
        kept=sum(map(len, asked.retained)),
        candidates=len(problem.candidates),
        loose=problem.limited and problem.loose,
        compared=compared,
        polished=None if smoother is None else smoother.told,
        order=arranged.told,
        robust=sturdy,
        how_many=curve,
    )


def _problem(
    resolved: ResolvedStudy, design: DesignTable, aims: StudyCriteria, place: Place
) -> search.DesignProblem:
    """Candidates with what is held, and the rules."""
    asked, measurement = resolved.design, resolved.measurement
    assert asked is not None
    try:
        found = candidates.build(
            measurement,
            resolved.candidates,
            measurement.nominal,
            design.scaling,
            whole_runs=design.whole_runs,
        )
    except ValueError as error:
        raise place.key("whole_runs").error(
            str(error), "give each run a table of its own"
        ) from error
    if design.prior or asked.retained:
        found = found.with_prior(_held(aims, measurement, asked.retained))
    rules = found.rules(
        size=design.size,
        budget=(
            None
            if design.budget_min is None
            else 60.0 * design.budget_min - plan_seconds(measurement, asked.retained)
        ),
        most_setups=design.setups_max,
        apart=asked.least_distance,
    )
    mounted = {s.setup for s in asked.retained}
    taken = tuple(k for k, name in enumerate(found.setups) if name in mounted)
    return search.DesignProblem(
        found, dataclasses.replace(rules, mounted=taken), design.starts
    )


def _held(
    aims: StudyCriteria, measurement: Measurement, kept: tuple[Series, ...]
) -> Array:
    return (
        aims.information(measurement, kept)
        if kept
        else np.eye(int(measurement.free.sum()))
    )


def _best(
    problem: search.DesignProblem,
    aims: StudyCriteria,
    name: str,
    rng: np.random.Generator,
    place: Place,
) -> Choice:
    try:
        return search.best(problem, aims.criterion(name, problem.candidates), rng)
    except ValueError as error:
        remedy = "ask for more readings, or give more candidates"
        raise place.error(
            str(error),
            remedy if ":" not in str(error) else "see `oed list criteria`",
            name,
        ) from error


def _compared(
    problem: search.DesignProblem,
    aims: StudyCriteria,
    main: Choice,
    rng: np.random.Generator,
    place: Place,
) -> tuple[result.CriterionComparison, ...]:
    """Designs for further criteria, each plan scored by each criterion; the main one
    first.
    """
    if not aims.design.compare:
        return ()
    own = aims.design.judged_by
    names = list(dict.fromkeys([own, *aims.design.compare]))
    choices = {own: main} | {
        n: _best(problem, aims, n, rng, place) for n in names if n != own
    }
    made = []
    for name in names:
        criterion = aims.criterion(name, problem.candidates)
        judged = {n: problem.judged(criterion, c.indices) for n, c in choices.items()}
        c = choices[name]
        made.append(
            result.CriterionComparison(
                name=name,
                value=c.value,
                bound=c.bound,
                efficiency=c.efficiency,
                proven=c.proven,
                gain=float(np.exp(judged[name][0] - judged[own][0])),
                values={n: number for n, (_, number) in judged.items()},
            )
        )
    return tuple(made)


def _mounted(resolved: ResolvedStudy, series: list[Series]) -> Measurement:
    """The machine with the set-ups that a plan uses; with all of them where recorded
    readings are to be fitted.
    """
    said = resolved.study.readings
    if resolved.dataset is not None or (said is not None and not said.simulate):
        return resolved.measurement
    return resolved.measurement_with({s.setup for s in series})


def kappa_map(circles: Circles, scaling: Scaling) -> result.KappaMap:
    """Condition number over circles and points on each."""
    table = []
    for m in circles.circles:
        row = []
        for n in circles.points:
            seen = explain.look(circles.measurement, [circles.series(m, n)], scaling)
            row.append(criteria.kappa(seen.verdict.identifiable))
        table.append(row)
    return result.KappaMap(
        circles.title, list(circles.circles), list(circles.points), table
    )


def single_stage_plan(
    resolved: ResolvedStudy, seen: explain.Seen, predicted: Mapping[str, float]
) -> result.PlanSection:
    """The readings as one stage, with its cost in minutes."""
    measurement = seen.measurement
    setups = list(dict.fromkeys(s.setup for s in seen.series))
    cost = plan_seconds(measurement, seen.series)
    stage = result.StageRecord(
        measurement=", ".join(
            dict.fromkeys(measurement.setups[n].instrument.name for n in setups)
        ),
        setups=setups,
        readings=sum(len(s) for s in seen.series),
        identifies=seen.verdict.rank,
        cost=cost / 60.0,
        kappa=criteria.kappa(seen.verdict.identifiable),
        predicted=dict(predicted),
    )
    return result.PlanSection(
        [stage], stage.cost, [p.name for p in resolved.reference_plans]
    )


def plan_seconds(measurement: Measurement, series: Sequence[Series]) -> float:
    """Time to mount the set-ups and take the readings of a plan, s."""
    mounting = sum(
        measurement.setups[n].instrument.cost.setup
        for n in dict.fromkeys(s.setup for s in series)
    )
    return mounting + sum(
        candidates.reading_time(measurement, s.setup) * len(s) for s in series
    )
