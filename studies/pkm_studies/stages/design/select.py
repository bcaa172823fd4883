"""Selects the readings of a plan from the candidates, polishes and orders them."""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np

from oed import units
from oed.base import Array, Index
from oed.design import CRITERIA, Candidates, Choice, DesignProblem, SizeCurve
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
from pkm_studies.resolve import (
    Circles,
    CommandRanges,
    DesignRequest,
    PredictionRequest,
    ResolvedStudy,
)
from pkm_studies.stages.design import order
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.recording import PlanToRecord, recording_section
from pkm_studies.tables import DesignTable

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


# Polishes the chosen poses, and free settings of their set-ups, off the grid.


@dataclasses.dataclass(frozen=True)
class PolishedPlan:
    """Readings as polished, with their set-ups as moved."""

    measurement: Measurement
    series: tuple[Series, ...]
    summary: PolishSummary | None


def polish_plan(
    study_criteria: StudyCriteria,
    measurement: Measurement,
    series: Sequence[Series],
    retained: Sequence[Series],
) -> PolishedPlan:
    """The chosen readings polished, or as they are where that gains nothing.

    Also where the study does not ask for it. `retained` readings are part of the plan
    and do not move. Raises InputError.
    """
    asked = study_criteria.table.polish
    if asked is None or not asked.enabled:
        return PolishedPlan(measurement, tuple(series), None)
    table, name = study_criteria.table, study_criteria.table.judged_by
    location = study_criteria.resolved.study.location.key("design").key("polish")
    ranges = _free_ranges(study_criteria, series, retained, location)
    try:
        polished = polish_readings(
            measurement,
            series,
            study_criteria.parameters_criterion(name, measurement),
            table.scaling,
            free=ranges,
            prior=_polish_information(study_criteria, measurement, retained),
            travel=_travel(study_criteria),
            clearance=asked.clearance,
            iterations=asked.iterations,
        )
    except ValueError as error:
        raise location.error(str(error), "mend it, or leave polishing out") from error
    before, value = study_criteria.score(name, measurement, [*retained, *series])
    after, new_value = study_criteria.score(
        name, polished.measurement, [*retained, *polished.series]
    )
    if after > before:
        moved = _moved_settings(polished.measurement, ranges)
        summary = PolishSummary(value, new_value, polished.summary, moved)
        return PolishedPlan(polished.measurement, polished.series, summary)
    phrase = "polishing does not improve the criterion"
    if polished.value_after == polished.value_before:
        phrase = polished.summary
    summary = PolishSummary(value, value, phrase, {})
    return PolishedPlan(measurement, tuple(series), summary)


def _travel(study_criteria: StudyCriteria) -> float | None:
    """How far a held reading may differ from what the instrument holds, m."""
    limits = study_criteria.table.limits
    if limits is None or limits.travel_mm is None:
        return None
    return float(units.to_si(limits.travel_mm, "mm"))


def _free_ranges(
    study_criteria: StudyCriteria,
    series: Sequence[Series],
    retained: Sequence[Series],
    location: Location,
) -> CommandRanges:
    """What polishing may move of the set-ups that the plan uses."""
    ranges = study_criteria.request.free_ranges
    fixed = {s.setup for s in retained}
    for name in ranges:
        if name in fixed:
            raise (
                location.key("free")
                .key(name)
                .error(
                    f"the retained readings of {name} were taken where it stands",
                    "move another set-up",
                )
            )
    used = {s.setup for s in series}
    return {name: limits for name, limits in ranges.items() if name in used}


def _polish_information(
    study_criteria: StudyCriteria, measurement: Measurement, retained: Sequence[Series]
) -> Array | None:
    """Information (n, n) before the polished readings: retained ones, tolerances."""
    if retained:
        return study_criteria.information(measurement, retained)
    if study_criteria.table.prior:
        return prior_information(measurement)
    return None


def _moved_settings(
    measurement: Measurement, ranges: CommandRanges
) -> dict[str, dict[str, float]]:
    """Where each free setting stands now, by set-up and column."""
    moved: dict[str, dict[str, float]] = {}
    for name, limits in ranges.items():
        setup = measurement.setups[name]
        unit = {s.name: s.unit for s in setup.instrument.settings}
        tool = zip(("tool_x", "tool_y", "tool_z"), setup.tool, strict=True)
        values = {**setup.settings, **dict(tool)}
        moved[name] = {}
        for setting in limits:
            si = unit.get(setting, "m")
            key, value = field(setting, values[setting], si)
            moved[name][key] = value
    return moved


# Predicts accuracy against the number of readings, and the fewest that suffice.


def accuracy_by_size(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    chosen: Choice,
    location: Location,
) -> HowManySummary | None:
    """The curve over the candidates, with bounds, and the fewest readings wanted.

    None where the study does not ask for it.
    Where not all set-ups can be mounted, over those of the chosen plan. Raises
    InputError for a component that the machine does not have.
    """
    table = study_criteria.table.how_many
    if table is None:
        return None
    c, location = problem.candidates, location.key("how_many")
    components = {x.name: x.unit for x in c.measurement.machine.components}
    wanted = quantities.read_values(table.wanted, components, location.key("wanted"))
    scale = wanted or _reached_accuracy(study_criteria, problem, chosen)
    names, factors = _factors(study_criteria, problem, scale)
    seed_key = Stream.HOW_MANY.key(study_criteria.resolved.study.seed)
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
    return msgspec.structs.replace(
        summary, fewest=fewest.size, at_least=fewest.at_least, most=most, words=phrase
    )


def _reached_accuracy(
    study_criteria: StudyCriteria, problem: DesignProblem, chosen: Choice
) -> dict[str, float]:
    """Accuracy, SI, that the chosen plan reaches in each component that moves."""
    names, factors = _factors(study_criteria, problem, {})
    accuracy = problem.accuracy(factors, chosen)
    return {n: float(v) for n, v in zip(names, accuracy, strict=True)}


def _factors(
    study_criteria: StudyCriteria, problem: DesignProblem, scale: Mapping[str, float]
) -> tuple[tuple[str, ...], Array]:
    """Components, and factors (K, r, n) over the candidates' columns, by `scale`.

    Only components in the scale; with an empty one, all that move, in SI.
    """
    maps, c = study_criteria.needed_maps, problem.candidates
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
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    nominal: Choice,
    rng: np.random.Generator,
    location: Location,
) -> tuple[Choice, RobustSummary | None]:
    """The robust plan over the nominal plan's set-ups, and what it gains over that.

    The nominal plan alone where the study does not ask for it.
    Raises InputError for criteria that are not smooth, and where drawn machines cannot
    reach the candidates.
    """
    table, location = study_criteria.table.robust, location.key("robust")
    if table is None:
        return nominal, None
    judged_by = study_criteria.table.judged_by
    scenarios = _scenarios(problem, study_criteria, table.scenarios, rng, location)
    criterion = study_criteria.candidates_criterion(judged_by, problem.candidates)
    try:
        return problem.choose_robust(
            criterion, nominal, scenarios, rng, risk=table.risk, tail_share=table.level
        )
    except ValueError as error:
        raise location.key("risk").error(
            str(error),
            f"choose one of {', '.join(CRITERIA.smooth)}, or leave the table out",
        ) from error


def _scenarios(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    count: int,
    rng: np.random.Generator,
    location: Location,
) -> Array:
    """Blocks (S, C, k, n) of the same commands on drawn machines; first the nominal."""
    c = problem.candidates
    measurement, table = c.measurement, study_criteria.table
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
                raise location.key("scenarios").error(
                    f"machines within the tolerances cannot reach all candidates: {error}",
                    "narrow the candidates, or the tolerances",
                ) from error
            continue
        blocks.append(scenario.blocks)
    return np.array(blocks)


# Chooses the readings of largest weight, and states the weights of the candidates.

#: least weight that is stated
MIN_STATED_WEIGHT = 1e-6


def choose_relaxed(
    problem: DesignProblem, study_criteria: StudyCriteria, location: Location
) -> tuple[Choice, RelaxedSummary]:
    """The plan of the largest weights, and the weights.

    Raises InputError where this plan leaves directions undetermined.
    """
    c, table = problem.candidates, study_criteria.table
    criterion = study_criteria.candidates_criterion(table.judged_by, c)
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
        weights=_stated(c, weighed.weights),
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

    measurement           with the set-ups that the plan uses, as polished
    series                readings in working order
    scheduled             the same with thermal reference readings in between
    choice                chosen candidates with their certificate
    criteria              the study's criteria
    retained              number of readings that were part of the plan already
    candidates            number of candidates
    bound_ignores_setups  whether the bound allows any number of set-ups
    compared              designs for further criteria
    polish, order, robust, how_many, relaxed, effects    summaries of these steps, where
                          they ran
    """

    measurement: Measurement
    series: tuple[Series, ...]
    scheduled: tuple[Series, ...]
    choice: Choice
    criteria: StudyCriteria
    retained: int
    candidates: int
    bound_ignores_setups: bool
    compared: tuple[CriterionComparison, ...]
    polish: PolishSummary | None
    order: WorkingOrder
    robust: RobustSummary | None
    how_many: HowManySummary | None
    relaxed: RelaxedSummary | None
    effects: AllowedEffects | None


def select_design(
    resolved: ResolvedStudy, rng: np.random.Generator
) -> ChosenDesign | None:
    """The best plan found; None where the study has no design or no candidates.

    Raises InputError where no plan under the rules serves the criterion.
    """
    table, request = resolved.study.design, resolved.design
    if table is None or request is None or not resolved.candidates:
        return None
    location = resolved.study.location.key("design")
    expected = allowed_effects(resolved, table, request, rng)
    size = chosen_size(table)
    planned = expected if expected is None or size == 1.0 else expected.of_size(size)
    study_criteria = StudyCriteria(resolved, table, request, planned)
    problem = _problem(resolved, study_criteria, location)
    field = "compound" if table.compound else "criterion"
    choice, relaxed_summary = _main_choice(
        problem, study_criteria, rng, location, field
    )
    at_expected = study_criteria, problem
    if planned is not expected:
        with_expected = StudyCriteria(resolved, table, request, expected)
        at_expected = with_expected, _problem(resolved, with_expected, location)
    summary_of_effects = _compare_rigid(at_expected, choice, rng, location, field)
    compared = _compared(problem, study_criteria, choice, rng, location.key("compare"))
    choice, robust_summary = choose_robust(
        problem, study_criteria, choice, rng, location
    )
    size_summary = accuracy_by_size(problem, study_criteria, choice, location)
    series = problem.candidates.readings_of(choice.indices)
    retained = request.retained
    measurement = _mounted(resolved, [*retained, *series])
    polished = polish_plan(study_criteria, measurement, series, retained)
    measurement, series = polished.measurement, polished.series
    ordered = order.order_plan(table, location, measurement, retained, series, rng)
    return ChosenDesign(
        measurement=measurement,
        series=ordered.series,
        scheduled=ordered.scheduled,
        choice=choice,
        criteria=at_expected[0],
        retained=sum(map(len, retained)),
        candidates=len(problem.candidates),
        bound_ignores_setups=problem.selects_setups and problem.bound_ignores_setups,
        compared=compared,
        polish=polished.summary,
        order=ordered.summary,
        robust=robust_summary,
        how_many=size_summary,
        relaxed=relaxed_summary,
        effects=summary_of_effects,
    )


def check_design(resolved: ResolvedStudy) -> None:
    """Raises InputError as `select_design`, for what needs no search."""
    table, request = resolved.study.design, resolved.design
    if table is None or request is None or not resolved.candidates:
        return
    if table.allows_effects:
        check_allowed(resolved, table, request)
    location = resolved.study.location.key("design")
    study_criteria = StudyCriteria(resolved, table, request)
    problem = _problem(resolved, study_criteria, location)
    name = table.judged_by
    field = "compound" if table.compound else "criterion"
    with _refused(name, location.key(field)):
        problem.check(study_criteria.candidates_criterion(name, problem.candidates))


def _main_choice(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    rng: np.random.Generator,
    location: Location,
    field: str,
) -> tuple[Choice, RelaxedSummary | None]:
    """The plan for the study's own criterion, and weights where it comes from these."""
    table = study_criteria.table
    summary = None
    if table.method == "relaxed":
        choice, summary = choose_relaxed(
            problem, study_criteria, location.key("method")
        )
    else:
        choice = _best(
            problem, study_criteria, table.judged_by, rng, location.key(field)
        )
    if table.branch_nodes:
        criterion = study_criteria.candidates_criterion(
            table.judged_by, problem.candidates
        )
        choice = problem.tighten(criterion, choice, table.branch_nodes, rng)
    return choice, summary


def _compare_rigid(
    at_expected: tuple[StudyCriteria, DesignProblem],
    choice: Choice,
    rng: np.random.Generator,
    location: Location,
    field: str,
) -> AllowedEffects | None:
    """The choice beside that of a machine without effects; None without effects.

    at_expected  criteria and problem of a machine with effects at their expected sizes
    """
    study_criteria, problem = at_expected
    if study_criteria.effects is None:
        return None
    without = _rigid_criteria(study_criteria, rng, location, field)
    return compare_without(problem, study_criteria, choice, without)


def _rigid_criteria(
    study_criteria: StudyCriteria,
    rng: np.random.Generator,
    location: Location,
    field: str,
) -> tuple[DesignProblem, Choice]:
    """The problem of a machine without effects, and its best plan."""
    resolved, table = study_criteria.resolved, study_criteria.table
    alone = StudyCriteria(resolved, table, study_criteria.request)
    problem = _problem(resolved, alone, location)
    return problem, _best(problem, alone, table.judged_by, rng, location.key(field))


def _problem(
    resolved: ResolvedStudy, study_criteria: StudyCriteria, location: Location
) -> DesignProblem:
    """Candidates with prior information, and the rules of a plan."""
    table, request = study_criteria.table, study_criteria.request
    measurement, planned = resolved.measurement, study_criteria.effects
    try:
        pool = Candidates.build(
            measurement,
            resolved.candidates,
            measurement.nominal,
            table.scaling,
            whole_runs=table.whole_runs,
            nuisances=None if planned is None else planned.readings,
        )
    except ValueError as error:
        raise location.key("whole_runs").error(
            str(error), "give each run a table of its own"
        ) from error
    if table.prior or request.retained:
        pool = pool.add_prior(_prior_information(study_criteria, measurement))
    mounted = {s.setup for s in request.retained}
    rules = pool.rules(
        size=table.size,
        budget=_budget(table, request, measurement),
        most_setups=table.setups_max,
        mounted=tuple(k for k, name in enumerate(pool.setups) if name in mounted),
        apart=request.least_distance,
        quotas=request.quotas,
    )
    return DesignProblem(pool, rules, table.starts)


def _budget(
    table: DesignTable, request: DesignRequest, measurement: Measurement
) -> float | None:
    """Time for new readings, s: the budget less the time of retained readings."""
    if table.budget_min is None:
        return None
    return 60.0 * table.budget_min - plan_seconds(measurement, request.retained)


def _prior_information(
    study_criteria: StudyCriteria, measurement: Measurement
) -> Array:
    """Information (n, n) of retained readings, or of the tolerances alone."""
    retained = study_criteria.request.retained
    if retained:
        return study_criteria.information(measurement, retained)
    return prior_information(measurement)


def _best(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    name: str,
    rng: np.random.Generator,
    location: Location,
) -> Choice:
    with _refused(name, location):
        criterion = study_criteria.candidates_criterion(name, problem.candidates)
        return problem.best_plan(criterion, rng)


@contextlib.contextmanager
def _refused(name: str, location: Location) -> Iterator[None]:
    """Errors of a search for a plan by a criterion as InputError."""
    try:
        yield
    except ValueError as error:
        remedy = "see `oed list criteria`"
        if ":" not in str(error):
            remedy = "ask for more readings, or give more candidates"
        raise location.error(str(error), remedy, name) from error


def _compared(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    choice: Choice,
    rng: np.random.Generator,
    location: Location,
) -> tuple[CriterionComparison, ...]:
    """Designs for further criteria, each scored by each criterion; the main one first."""
    table = study_criteria.table
    if not table.compare:
        return ()
    main = table.judged_by
    choices = {main: choice}
    for name in dict.fromkeys(table.compare):
        if name != main:
            choices[name] = _best(problem, study_criteria, name, rng, location)
    comparisons = []
    for name, design in choices.items():
        criterion = study_criteria.candidates_criterion(name, problem.candidates)
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


def _mounted(resolved: ResolvedStudy, series: list[Series]) -> Measurement:
    """The machine with the set-ups that a plan uses.

    Where recorded readings are to be fitted, with all set-ups.
    """
    readings = resolved.study.readings
    recorded = readings is not None and not readings.simulate
    if resolved.dataset is not None or recorded:
        return resolved.measurement
    return resolved.measurement_with({s.setup for s in series})


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
    resolved: ResolvedStudy,
    table: DesignTable,
    request: DesignRequest,
    rng: np.random.Generator,
) -> PlannedEffects | None:
    """What the effects of [design] do to its candidates; None without any.

    Raises InputError for names that are no effects, and where the design cannot allow for
    any.
    """
    if not table.allows_effects:
        return None
    return resolved.gap_or_default.planned_effects(
        resolved.measurement,
        resolved.candidates,
        table.effects,
        resolved.study.location.key("design").key("effects"),
        check_allowed(resolved, table, request),
        rng,
    )


def chosen_size(table: DesignTable) -> float:
    """Size of the effects that a plan is chosen for, in expected sizes.

    Those that [design] names are as large as expected. Of the catalogue, a machine has
    few that are: its effects have the typical size that a fit expects of a healthy
    machine. A plan for these loses little on a machine without effects or with large ones.
    """
    return Discrepancy.HEALTHY if isinstance(table.effects, str) else 1.0


def check_allowed(
    resolved: ResolvedStudy, table: DesignTable, request: DesignRequest
) -> PredictionRequest:
    """Where accuracy counts. Raises InputError where a design can allow for no effect."""
    location = resolved.study.location.key("design").key("effects")
    reasons = {
        'need scaling = "tolerance"': table.scaling != "tolerance",
        "are not known of readings that are part of the plan": bool(request.retained),
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
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    choice: Choice,
    without: tuple[DesignProblem, Choice],
) -> AllowedEffects | None:
    """The choice beside that for a machine without effects; None without effects.

    without  the problem without effects, and its choice
    """
    effects = study_criteria.effects
    if effects is None:
        return None
    rigid_problem, rigid = without
    name = study_criteria.table.judged_by
    criterion = study_criteria.candidates_criterion(name, problem.candidates)
    chosen_value = problem.score(criterion, choice.indices)[0]
    rigid_value = problem.score(criterion, rigid.indices)[0]
    rigid_criteria = StudyCriteria(
        study_criteria.resolved, study_criteria.table, study_criteria.request
    )
    alone = rigid_criteria.candidates_criterion(name, rigid_problem.candidates)
    best_alone = rigid_problem.score(alone, rigid.indices)[0]
    chosen_alone = rigid_problem.score(alone, choice.indices)[0]
    none = np.zeros(0, dtype=np.intp)
    return AllowedEffects(
        groups=len(effects.groups),
        unknowns=effects.readings.count,
        efficiency=float(np.exp(rigid_value - chosen_value)),
        efficiency_without=float(np.exp(chosen_alone - best_alone)),
        accuracy=_accuracy(problem, study_criteria, effects, choice.indices),
        accuracy_without=_accuracy(problem, study_criteria, effects, rigid.indices),
        before=_accuracy(problem, study_criteria, effects, none),
        size=chosen_size(study_criteria.table),
    )


def recording(
    criteria: StudyCriteria, measurement: Measurement, series: Sequence[Series]
) -> RecordingSection | None:
    """What else to record beside the readings of a design with effects."""
    resolved, table = criteria.resolved, criteria.table
    if resolved.prediction is None or criteria.effects is None:
        return None
    gap = resolved.gap_or_default
    location = resolved.study.location.key("design").key("effects")
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


def _accuracy(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    effects: PlannedEffects,
    chosen: Index,
) -> dict[str, float]:
    """Rms error of each component with the chosen readings, in its fine unit."""
    c, maps = problem.candidates, study_criteria.needed_maps
    measurement = c.measurement
    if not study_criteria.table.prior:
        c = c.add_prior(prior_information(measurement))
    total = c.information(chosen)
    covariance = np.linalg.inv(total)
    slopes = c.pose_error_slopes(maps.raw, effects.tool)
    variance = np.einsum("nkp,pq,nkq->k", slopes, covariance, slopes, optimize=True)
    mean = variance / len(slopes) + effects.others
    rms = dict(zip(maps.names, np.sqrt(mean).tolist(), strict=True))
    return fine_units(rms, measurement.machine)
