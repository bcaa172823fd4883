"""Selects the readings of a plan from the candidates, polishes and orders them."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from oed import units
from oed.base import Array, Index
from oed.design import CRITERIA, Candidates, Choice, Criterion, DesignProblem, SizeCurve
from oed.effects import PlannedEffects
from oed.estimation import Discrepancy
from oed.identifiability import Assessment, Scaling, prior_information
from oed.measurement import Measurement, Series, draw_parameters
from oed.mechanism import AssemblyError
from oed.poses import polish_readings
from oed.result import (
    AllowedEffects,
    AlternativePlan,
    CandidateWeight,
    CriterionComparison,
    HowManySummary,
    KappaMap,
    PlanSection,
    PolishSummary,
    RecordingSection,
    RelaxedSummary,
    RobustSummary,
    StageRecord,
    WorkingOrder,
)
from pkm_studies import quantities
from pkm_studies.base import Location, Stream
from pkm_studies.describe import displayed_command, field
from pkm_studies.quantities import fine_units
from pkm_studies.resolve import Circles, CommandRanges, PredictionRequest, ResolvedStudy
from pkm_studies.stages.design import order
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.recording import PlanToRecord, recording_section


# The time that a plan takes, and the plan section of a study without [plan].
def plan_seconds(measurement: Measurement, series: Sequence[Series]) -> float:
    """Time to mount the set-ups and take the readings of a plan, s."""
    setups = dict.fromkeys(s.setup for s in series)
    mounting = sum(measurement.setups[n].instrument.cost.setup for n in setups)
    return mounting + sum(measurement.reading_seconds(s.setup) * len(s) for s in series)


def single_stage_plan(
    resolved: ResolvedStudy, identifiability: Assessment, predicted: Mapping[str, float]
) -> PlanSection:
    """The readings as one stage, with their cost in minutes."""
    measurement, series = identifiability.measurement, identifiability.series
    verdict = identifiability.identifiability
    setups = list(dict.fromkeys(s.setup for s in series))
    instruments = [measurement.setups[n].instrument.name for n in setups]
    stage = StageRecord(
        measurement=", ".join(dict.fromkeys(instruments)),
        setups=setups,
        readings=sum(len(s) for s in series),
        identifies=verdict.rank,
        cost=plan_seconds(measurement, series) / 60.0,
        kappa=CRITERIA.index("kappa", verdict.identifiable_singular_values),
        predicted=dict(predicted),
    )
    references: list[str | AlternativePlan] = [
        plan.name for plan in resolved.reference_plans
    ]
    return PlanSection([stage], stage.cost, references)


# Candidates under the rules of a plan, with what judges it.
@dataclasses.dataclass(frozen=True)
class DesignSearch:
    """The criteria of a study's plan, and its candidates under the rules of a plan."""

    criteria: StudyCriteria
    problem: DesignProblem

    @classmethod
    def build(
        cls, resolved: ResolvedStudy, effects: PlannedEffects | None = None
    ) -> DesignSearch:
        """Candidates with prior information, and the rules. Raises InputError."""
        criteria = StudyCriteria(resolved, effects)
        table, request = criteria.table, criteria.request
        measurement = resolved.measurement
        try:
            pool = Candidates.build(
                measurement,
                resolved.candidates,
                measurement.nominal,
                table.scaling,
                whole_runs=table.whole_runs,
                nuisances=None if effects is None else effects.readings,
            )
        except ValueError as error:
            raise criteria.location.key("whole_runs").error(
                str(error), "give each run a table of its own"
            ) from error
        retained = request.retained
        if retained:
            pool = pool.add_prior(criteria.information(measurement, retained))
        elif table.prior:
            pool = pool.add_prior(prior_information(measurement))
        budget = None
        if table.budget_min is not None:
            budget = 60.0 * table.budget_min - plan_seconds(measurement, retained)
        mounted = {s.setup for s in retained}
        rules = pool.rules(
            size=table.size,
            budget=budget,
            most_setups=table.setups_max,
            mounted=tuple(k for k, name in enumerate(pool.setups) if name in mounted),
            apart=request.least_distance,
            quotas=request.quotas,
        )
        return cls(criteria, DesignProblem(pool, rules, table.starts))

    def criterion(self, name: str) -> Criterion:
        """The criterion over the candidates' columns."""
        return self.criteria.candidates_criterion(name, self.problem.candidates)

    @property
    def main_criterion(self) -> Criterion:
        """The criterion that the study's own plan is judged by."""
        return self.criterion(self.criteria.table.judged_by)

    def check(self) -> None:
        """Raises InputError where no search by the study's criterion is possible."""
        with self._refused(self.criteria.table.judged_by, self._main_field):
            self.problem.check(self.main_criterion)

    def best_plan(
        self, rng: np.random.Generator, name: str = "", field: str = ""
    ) -> Choice:
        """The best plan by a criterion, or the study's own. Raises InputError."""
        name, field = name or self.criteria.table.judged_by, field or self._main_field
        with self._refused(name, field):
            return self.problem.best_plan(self.criterion(name), rng)

    def accuracy(self, effects: PlannedEffects, chosen: Index) -> dict[str, float]:
        """Rms error of each component with the chosen readings, in its fine unit."""
        c, maps = self.problem.candidates, self.criteria.needed_maps
        measurement = c.measurement
        if not self.criteria.table.prior:
            c = c.add_prior(prior_information(measurement))
        covariance = np.linalg.inv(c.information(chosen))
        slopes = c.pose_error_slopes(maps.raw, effects.tool)
        variance = np.einsum("nkp,pq,nkq->k", slopes, covariance, slopes, optimize=True)
        mean = variance / len(slopes) + effects.others
        rms = dict(zip(maps.names, np.sqrt(mean).tolist(), strict=True))
        return fine_units(rms, measurement.machine)

    @property
    def _main_field(self) -> str:
        return "compound" if self.criteria.table.compound else "criterion"

    @contextlib.contextmanager
    def _refused(self, name: str, field: str) -> Iterator[None]:
        """Errors of a search for a plan by a criterion as InputError."""
        try:
            yield
        except ValueError as error:
            remedy = "see `oed list criteria`"
            if ":" not in str(error):
                remedy = "ask for more readings, or give more candidates"
            location = self.criteria.location.key(field)
            raise location.error(str(error), remedy, name) from error


# Polishes the chosen poses, and free settings of their set-ups, off the grid.
#: readings as polished, with their set-ups as moved
PolishedPlan = tuple[Measurement, tuple[Series, ...], PolishSummary | None]


def polish_plan(
    criteria: StudyCriteria, measurement: Measurement, series: Sequence[Series]
) -> PolishedPlan:
    """The chosen readings polished, or as they are where that gains nothing.

    Also where the study does not ask for it. Retained readings are part of the plan
    and do not move. Raises InputError.
    """
    table, retained = criteria.table, criteria.request.retained
    asked = table.polish
    if asked is None or not asked.enabled:
        return measurement, tuple(series), None
    name, location = table.judged_by, criteria.location.key("polish")
    ranges = _free_ranges(criteria, series, location)
    travel = None
    if table.limits is not None and table.limits.travel_mm is not None:
        travel = float(units.to_si(table.limits.travel_mm, "mm"))
    prior = prior_information(measurement) if table.prior else None
    if retained:
        prior = criteria.information(measurement, retained)
    try:
        polished = polish_readings(
            measurement,
            series,
            criteria.parameters_criterion(name, measurement),
            table.scaling,
            free=ranges,
            prior=prior,
            travel=travel,
            clearance=asked.clearance,
            iterations=asked.iterations,
        )
    except ValueError as error:
        raise location.error(str(error), "mend it, or leave polishing out") from error
    before, value = criteria.score(name, measurement, [*retained, *series])
    after, new_value = criteria.score(
        name, polished.measurement, [*retained, *polished.series]
    )
    if after > before:
        # where each free setting stands now, by set-up and column
        moved: dict[str, dict[str, float]] = {}
        for setup_name, limits in ranges.items():
            setup = polished.measurement.setups[setup_name]
            unit = {s.name: s.unit for s in setup.instrument.settings}
            tool = zip(("tool_x", "tool_y", "tool_z"), setup.tool, strict=True)
            values = {**setup.settings, **dict(tool)}
            moved[setup_name] = {}
            for setting in limits:
                si = unit.get(setting, "m")
                key, stands = field(setting, values[setting], si)
                moved[setup_name][key] = stands
        summary = PolishSummary(value, new_value, polished.summary, moved)
        return polished.measurement, polished.series, summary
    phrase = "polishing does not improve the criterion"
    if polished.value_after == polished.value_before:
        phrase = polished.summary
    summary = PolishSummary(value, value, phrase, {})
    return measurement, tuple(series), summary


def _free_ranges(
    criteria: StudyCriteria, series: Sequence[Series], location: Location
) -> CommandRanges:
    """What polishing may move of the set-ups that the plan uses."""
    ranges = criteria.request.free_ranges
    fixed = {s.setup for s in criteria.request.retained}
    for name in ranges:
        if name in fixed:
            problem = f"the retained readings of {name} were taken where it stands"
            field = location.path("free", name)
            raise field.error(problem, "move another set-up")
    used = {s.setup for s in series}
    return {name: limits for name, limits in ranges.items() if name in used}


# Predicts accuracy against the number of readings, and the fewest that suffice.
def accuracy_by_size(search: DesignSearch, chosen: Choice) -> HowManySummary | None:
    """The curve over the candidates, with bounds, and the fewest readings wanted.

    None where the study does not ask for it.
    Where not all set-ups can be mounted, over those of the chosen plan. Raises
    InputError for a component that the machine does not have.
    """
    criteria, problem = search.criteria, search.problem
    table = criteria.table.how_many
    if table is None:
        return None
    components = {x.name: x.unit for x in criteria.resolved.machine.components}
    location = criteria.location.path("how_many", "wanted")
    wanted = quantities.read_values(table.wanted, components, location)
    scale = wanted or _reached_accuracy(search, chosen)
    names, factors = _factors(search, scale)
    seed_key = Stream.HOW_MANY.key(criteria.resolved.study.seed)
    size_curve = problem.size_curve(chosen, names, factors, seed_key)
    count = len(size_curve.blocks)
    points = size_curve.curve([n for n in table.readings if n <= count])
    fine = {n: units.FINE[components[n]] for n in names}
    reached = np.array([p.accuracy for p in points])
    bounds = np.array([p.bound for p in points])

    def component_shares(shares: Array) -> dict[str, list[float]]:
        """Shares (sizes, components) of the scale, by component in its fine unit."""
        columns = {}
        for k, name in enumerate(names):
            si = [float(share) * scale[name] for share in shares[:, k]]
            columns[f"{name}_{fine[name]}"] = [units.number(v, fine[name]) for v in si]
        return columns

    summary = HowManySummary(
        wanted={f"{n}_{fine[n]}": units.number(v, fine[n]) for n, v in wanted.items()},
        sizes=[p.size for p in points],
        accuracy=component_shares(reached),
        bound=component_shares(bounds),
    )
    if not wanted:
        return summary
    return _fewest_sentences(summary, size_curve, min(table.most, count))


def _fewest_sentences(
    summary: HowManySummary, size_curve: SizeCurve, most: int
) -> HowManySummary:
    """The summary with the fewest readings that reach the wanted accuracy."""
    fewest = size_curve.fewest(most)
    if fewest.size is None:
        pairs = zip(size_curve.goal.names, fewest.best.accuracy, strict=True)
        missed = ", ".join(name for name, share in pairs if share > 1.0)
        reason = "the search found no plan that does"
        if fewest.at_least > most:
            reason = "by the bound, no plan of that size can"
        phrase = (
            f"{most} readings do not reach it in {missed}; {reason}. Add a set-up or"
            " another instrument."
        )
    elif fewest.proven:
        phrase = f"{fewest.size} readings reach it, and no plan of fewer can."
    else:
        phrase = (
            f"{fewest.size} readings reach it; no plan of fewer than {fewest.at_least}"
            " can."
        )
    return replace(
        summary, fewest=fewest.size, at_least=fewest.at_least, most=most, words=phrase
    )


def _reached_accuracy(search: DesignSearch, chosen: Choice) -> dict[str, float]:
    """Accuracy, SI, that the chosen plan reaches in each component that moves."""
    names, factors = _factors(search, {})
    accuracy = search.problem.accuracy(factors, chosen)
    return {n: float(v) for n, v in zip(names, accuracy, strict=True)}


def _factors(
    search: DesignSearch, scale: Mapping[str, float]
) -> tuple[tuple[str, ...], Array]:
    """Components of the scale, or all, and factors (K, r, n) over the columns."""
    maps, c = search.criteria.needed_maps, search.problem.candidates
    measurement = c.measurement
    poses, _, machine_parameters = maps.raw.shape
    moving = [n for k, n in enumerate(maps.names) if maps.raw[:, k].any()]
    names = [n for n in moving if n in scale] if scale else moving
    factors = []
    for name in names:
        raw = maps.raw[:, maps.names.index(name)]
        slopes = np.zeros((poses, len(measurement.names)))
        slopes[:, :machine_parameters] = raw / (scale.get(name, 1.0) * np.sqrt(poses))
        rows = (slopes * measurement.tolerance)[:, measurement.free]
        triangle = np.linalg.qr(rows, mode="r") if len(rows) > rows.shape[1] else rows
        factors.append(np.pad(triangle, ((0, 0), (0, c.shared_errors))))
    return tuple(names), np.array(factors)


# Chooses a plan for many machines, drawn from the tolerances of parameters.

#: machines drawn for each scenario until one reaches all candidates
MAX_MACHINE_DRAWS = 5


def choose_robust(
    search: DesignSearch, nominal: Choice, rng: np.random.Generator
) -> tuple[Choice, RobustSummary | None]:
    """The robust plan over the nominal plan's set-ups, and what it gains over that.

    The nominal plan alone where the study does not ask for it.
    Raises InputError for criteria that are not smooth, and where drawn machines cannot
    reach the candidates.
    """
    table = search.criteria.table.robust
    if table is None:
        return nominal, None
    scenarios = _scenarios(search, table.scenarios, rng)
    criterion = search.main_criterion
    try:
        return search.problem.choose_robust(
            criterion, nominal, scenarios, rng, risk=table.risk, tail_share=table.level
        )
    except ValueError as error:
        raise search.criteria.location.path("robust", "risk").error(
            str(error),
            f"choose one of {', '.join(CRITERIA.smooth)}, or leave the table out",
        ) from error


def _scenarios(search: DesignSearch, count: int, rng: np.random.Generator) -> Array:
    """Blocks (S, C, k, n) of the same commands on drawn machines; first the nominal."""
    c, table = search.problem.candidates, search.criteria.table
    measurement = c.measurement
    blocks = [c.blocks]
    failures = 0
    while len(blocks) < count:
        theta = draw_parameters(measurement, rng)
        try:
            scenario = Candidates.build(
                measurement,
                c.series,
                theta,
                table.scaling,
                whole_runs=table.whole_runs,
                nuisances=c.nuisances,
            )
        except AssemblyError as error:
            failures += 1
            if failures > MAX_MACHINE_DRAWS * count:
                location = search.criteria.location.path("robust", "scenarios")
                raise location.error(
                    f"machines within the tolerances cannot reach all candidates: {error}",
                    "narrow the candidates, or the tolerances",
                ) from error
            continue
        blocks.append(scenario.blocks)
    return np.array(blocks)


# Chooses the readings of largest weight, and states the weights of the candidates.

MIN_STATED_WEIGHT = 1e-6  #: least weight that is stated


def choose_relaxed(search: DesignSearch) -> tuple[Choice, RelaxedSummary]:
    """The plan of the largest weights, and these. Raises InputError if undetermined."""
    problem, table = search.problem, search.criteria.table
    location = search.criteria.location.key("method")
    criterion = search.main_criterion
    solver = table.solver or "built_in"
    if problem.rules.size is None:
        reason = "weights need the number of readings, which a budget leaves open"
        raise location.error(reason, "give readings, not budget_min", table.method)
    try:
        weighed = problem.weigh(criterion, solver)
    except ValueError as error:
        remedy = "leave method out, ask for more readings, or give more candidates"
        raise location.error(str(error), remedy, table.method) from error
    summary = RelaxedSummary(
        solver=solver,
        value=weighed.value,
        bound=weighed.bound,
        gap=weighed.duality_gap,
        weights=_stated(problem.candidates, weighed.weights),
    )
    return weighed.choice, summary


def _stated(candidates: Candidates, weights: Array) -> list[CandidateWeight]:
    """The weights that are not 0, largest first."""
    stated = []
    machine = candidates.measurement.machine
    for k in np.argsort(-weights, kind="stable"):
        if weights[k] < MIN_STATED_WEIGHT:
            break
        series = candidates.readings_of(np.array([k], dtype=np.intp))[0]
        weight = CandidateWeight(
            setup=series.setup,
            run=str(series.run[0]),
            command=displayed_command(machine, series.reading_commands()[0]),
            weight=float(weights[k]),
        )
        stated.append(weight)
    return stated


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChosenDesign:
    """The plan in working order, and how it was found.

    polish, order, robust, how_many, relaxed, effects    summaries of these steps, where
                          they ran
    """

    measurement: Measurement  #: with the set-ups that the plan uses, as polished
    series: tuple[Series, ...]  #: readings in working order
    #: the same with thermal reference readings in between
    scheduled: tuple[Series, ...]
    choice: Choice  #: chosen candidates with their certificate
    criteria: StudyCriteria  #: the study's criteria
    retained: int  #: number of readings that were part of the plan already
    candidates: int  #: number of candidates
    bound_ignores_setups: bool  #: whether the bound allows any number of set-ups
    compared: tuple[CriterionComparison, ...]  #: designs for further criteria
    polish: PolishSummary | None
    order: WorkingOrder
    robust: RobustSummary | None
    how_many: HowManySummary | None
    relaxed: RelaxedSummary | None
    effects: AllowedEffects | None


def select_design(
    resolved: ResolvedStudy, rng: np.random.Generator
) -> ChosenDesign | None:
    """The best plan, or None without candidates. Raises InputError where none serves."""
    if not _has_design(resolved):
        return None
    expected = allowed_effects(resolved, rng)
    size = chosen_size(resolved)
    planned = expected if expected is None or size == 1.0 else expected.of_size(size)
    search = DesignSearch.build(resolved, planned)
    table = search.criteria.table
    relaxed_summary = None
    if table.method == "relaxed":
        choice, relaxed_summary = choose_relaxed(search)
    else:
        choice = search.best_plan(rng)
    if table.branch_nodes:
        criterion = search.main_criterion
        choice = search.problem.tighten(criterion, choice, table.branch_nodes, rng)
    at_expected = search
    if planned is not expected:
        at_expected = DesignSearch.build(resolved, expected)
    summary_of_effects = None
    if expected is not None:
        summary_of_effects = compare_without(at_expected, expected, choice, rng)
    compared = _compared(search, choice, rng)
    choice, robust_summary = choose_robust(search, choice, rng)
    size_summary = accuracy_by_size(search, choice)
    problem, criteria = search.problem, search.criteria
    series = problem.candidates.readings_of(choice.indices)
    retained = criteria.request.retained
    readings = resolved.study.readings
    recorded = readings is not None and not readings.simulate
    measurement = resolved.measurement
    if resolved.dataset is None and not recorded:
        measurement = resolved.measurement_with({s.setup for s in [*retained, *series]})
    measurement, polished, summary = polish_plan(criteria, measurement, series)
    ordered = order.order_plan(
        criteria.table, criteria.location, measurement, retained, polished, rng
    )
    return ChosenDesign(
        measurement=measurement,
        series=ordered.series,
        scheduled=ordered.scheduled,
        choice=choice,
        criteria=at_expected.criteria,
        retained=sum(map(len, retained)),
        candidates=len(problem.candidates),
        bound_ignores_setups=problem.selects_setups and problem.bound_ignores_setups,
        compared=compared,
        polish=summary,
        order=ordered.summary,
        robust=robust_summary,
        how_many=size_summary,
        relaxed=relaxed_summary,
        effects=summary_of_effects,
    )


def check_design(resolved: ResolvedStudy) -> None:
    """Raises InputError as `select_design`, for what needs no search."""
    if not _has_design(resolved):
        return
    table = resolved.study.design
    if table is not None and table.allows_effects:
        check_allowed(resolved)
    DesignSearch.build(resolved).check()


def _has_design(resolved: ResolvedStudy) -> bool:
    is_asked = resolved.study.design is not None and resolved.design is not None
    return is_asked and bool(resolved.candidates)


def _compared(
    search: DesignSearch, choice: Choice, rng: np.random.Generator
) -> tuple[CriterionComparison, ...]:
    """Designs for further criteria, each scored by each criterion; the main one first."""
    table, problem = search.criteria.table, search.problem
    if not table.compare:
        return ()
    main = table.judged_by
    choices = {main: choice}
    for name in dict.fromkeys(table.compare):
        if name != main:
            choices[name] = search.best_plan(rng, name, "compare")
    comparisons = []
    for name, design in choices.items():
        criterion = search.criterion(name)
        scores = {n: problem.score(criterion, c.indices) for n, c in choices.items()}
        comparison = CriterionComparison(
            name=name,
            value=design.value,
            bound=design.bound,
            efficiency=design.efficiency,
            proven=design.proven,
            gain=float(np.exp(scores[name][0] - scores[main][0])),
            values={n: value for n, (_, value) in scores.items()},
        )
        comparisons.append(comparison)
    return tuple(comparisons)


def kappa_map(circles: Circles, scaling: Scaling) -> KappaMap:
    """Condition number over the number of circles and of points on each."""
    table = []
    for of_circles in circles.every_series():
        assessed = [
            Assessment.of(
                circles.measurement, [series, *circles.further], scaling
            ).identifiability
            for series in of_circles
        ]
        values = [identified.identifiable_singular_values for identified in assessed]
        table.append([CRITERIA.index("kappa", v) for v in values])
    return KappaMap(circles.title, list(circles.circles), list(circles.points), table)


# A design that allows for effects, and what the plan without them would lose.
def allowed_effects(
    resolved: ResolvedStudy, rng: np.random.Generator
) -> PlannedEffects | None:
    """What the effects of [design] do to its candidates; None without any.

    Raises InputError for names that are no effects, and where the design cannot allow for
    any.
    """
    table = resolved.study.design
    if table is None or not table.allows_effects:
        return None
    return resolved.gap_or_default.planned_effects(
        resolved.measurement,
        resolved.candidates,
        table.effects,
        resolved.study.location.path("design", "effects"),
        check_allowed(resolved),
        rng,
    )


def chosen_size(resolved: ResolvedStudy) -> float:
    """Size of the effects that a plan is chosen for, in expected sizes.

    Those that [design] names are as large as expected. Of the catalogue, a machine has
    few that are: its effects have the typical size that a fit expects of a healthy
    machine. A plan for these loses little on a machine without effects or with large ones.
    """
    table = resolved.study.design
    is_catalogue = table is not None and isinstance(table.effects, str)
    return Discrepancy.HEALTHY if is_catalogue else 1.0


def check_allowed(resolved: ResolvedStudy) -> PredictionRequest:
    """Where accuracy counts. Raises InputError where a design can allow for no effect."""
    location = resolved.study.location.path("design", "effects")
    criteria = StudyCriteria(resolved)
    table = criteria.table
    reasons = {
        'need scaling = "tolerance"': table.scaling != "tolerance",
        "are not known of readings that are part of the plan": bool(
            criteria.request.retained
        ),
        "are not in accuracy by number of readings (how_many)": (
            table.how_many is not None
        ),
        "are not known of poses off the grid (polish)": (
            table.polish is not None and table.polish.enabled
        ),
    }
    for reason, holds in reasons.items():
        if holds:
            raise location.error(
                f"effects beside the geometry {reason}", 'write effects = "none"'
            )
    if resolved.prediction is None:
        raise location.error(
            "what effects do to the tool needs a workspace",
            "add [prediction], or leave effects out",
        )
    return resolved.prediction


def compare_without(
    search: DesignSearch,
    effects: PlannedEffects,
    choice: Choice,
    rng: np.random.Generator,
) -> AllowedEffects:
    """The choice with effects, as expected, beside the best plan without them."""
    alone = DesignSearch.build(search.criteria.resolved)
    rigid = alone.best_plan(rng)
    criterion, criterion_alone = search.main_criterion, alone.main_criterion
    chosen_value = search.problem.score(criterion, choice.indices)[0]
    rigid_value = search.problem.score(criterion, rigid.indices)[0]
    best_alone = alone.problem.score(criterion_alone, rigid.indices)[0]
    chosen_alone = alone.problem.score(criterion_alone, choice.indices)[0]
    none = np.zeros(0, dtype=np.intp)
    return AllowedEffects(
        groups=len(effects.groups),
        unknowns=effects.readings.count,
        efficiency=float(np.exp(rigid_value - chosen_value)),
        efficiency_without=float(np.exp(chosen_alone - best_alone)),
        accuracy=search.accuracy(effects, choice.indices),
        accuracy_without=search.accuracy(effects, rigid.indices),
        before=search.accuracy(effects, none),
        size=chosen_size(search.criteria.resolved),
    )


def recording(
    criteria: StudyCriteria, measurement: Measurement, series: Sequence[Series]
) -> RecordingSection | None:
    """What else to record beside the readings of a design with effects."""
    resolved, table = criteria.resolved, criteria.table
    if resolved.prediction is None or criteria.effects is None:
        return None
    gap = resolved.gap_or_default
    location = resolved.study.location.path("design", "effects")
    return recording_section(
        PlanToRecord(
            measurement=measurement,
            series=tuple(series),
            planned=criteria.effects,
            effects=gap.named_effects(table.effects, location),
            request=gap,
            prediction=resolved.prediction,
            information=prior_information(measurement),
            seed=Stream.PLANNED_COURSES.key(resolved.study.seed),
            further={},
        )
    )
