"""Advises at the machine: what is known now, the best next reading, when to stop."""

from __future__ import annotations

import csv
import dataclasses
import functools
import shlex
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from oed import trust, units
from oed.accuracy import ErrorMaps
from oed.base import Array, Mask
from oed.dataset import ReadingsColumn, SplitText, decode, is_remark
from oed.design import Candidates
from oed.effects import PlannedEffects
from oed.estimation import Estimate, IdentificationError, identify
from oed.identifiability import prior_information
from oed.measurement import Measurement, Series, reading_structure
from oed.noise import Laws
from oed.poses import Belief
from oed.result import ChosenRun, GapSection, Judgement, StudyResult
from oed.text import format_number, format_probability
from oed.verdict import SURE_PROBABILITY, judge, overall
from pkm_studies import describe, quantities
from pkm_studies.base import InputError, Silent, Stream
from pkm_studies.quantities import component_values
from pkm_studies.result_folder import VISIT
from pkm_studies.results import load_result
from pkm_studies.stages import (
    Measured,
    RunState,
    checked,
    estimate_section,
    select_design,
)
from pkm_studies.study import Study

# Effects beside the geometry in the advice at the machine, at their expected sizes.

DRAWN_MACHINES = 4000  #: machines that are drawn for an interval or a probability
OUT_OF_REACH = 1e-9  #: share of a wanted accuracy that no reading reaches


@dataclasses.dataclass(frozen=True, eq=False)
class Outlook:
    """What is known, and the candidates for the next reading.

    before   what was known before any reading;  now  what is known
    """

    pool: Candidates  #: of the candidates, after the `taken` readings
    taken: int
    before: Belief
    now: Belief
    others: Array  #: (K,) mean square over the workspace that no reading can reduce, SI
    holds_effects: bool = False  #: whether effects beside the geometry are in all this

    @property
    def blocks(self) -> Array:
        """Blocks (C, k, n) of the candidates."""
        return self.pool.blocks[self.taken :]

    def accuracy(self, belief: Belief) -> Array:
        """Rms (K,) of a belief."""
        return np.asarray(np.sqrt(belief.variances + self.others))

    @functools.cached_property
    def drawn_rms(self) -> Array:
        """Rms errors (machines, K), SI, that this machine may have."""
        rng = np.random.default_rng(0)
        values, vectors = np.linalg.eigh(self.now.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        squares = rng.standard_normal((DRAWN_MACHINES, len(values))) ** 2
        columns = []
        for weight, other in zip(self.now.weights, self.others, strict=True):
            spread = np.linalg.eigvalsh(root.T @ weight @ root)
            columns.append(squares @ np.maximum(spread, 0.0) + other)
        return np.asarray(np.sqrt(np.column_stack(columns)))

    def pass_probabilities(self, wanted: Array) -> tuple[Array, Array]:
        """Probabilities (K,) that wanted rms errors (K,) are met; NaN where none is.

        The second result is the expected rms errors (K,) with which they pass: a pass
        needs a high quantile of the error within what is wanted.
        """
        drawn = self.drawn_rms
        share = np.where(np.isfinite(wanted), (drawn <= wanted).mean(axis=0), np.nan)
        upper = np.maximum(
            np.quantile(drawn, SURE_PROBABILITY, axis=0), np.finfo(float).tiny
        )
        return share, wanted * self.accuracy(self.now) / upper

    def limits(self, wanted: Array) -> Array:
        """Wanted rms (K,) left to readings: NaN for none, tiny where the rest is more."""
        least = (OUT_OF_REACH * wanted) ** 2
        return np.asarray(np.sqrt(np.maximum(wanted**2 - self.others, least)))


def effects_at(
    state: RunState, measurement: Measurement, taken: Sequence[Series]
) -> PlannedEffects | None:
    """What the effects of [identify] do to readings taken and candidates; None without."""
    resolved = state.resolved
    if resolved.prediction is None:
        return None
    return resolved.gap_or_default.planned_effects(
        measurement,
        [*taken, *resolved.candidates],
        state.study.identify.fitted_effects,
        state.study.location.path("identify", "effects"),
        resolved.prediction,
        Stream.PLANNED_COURSES.rng(state.study.seed),
    )


#: how a file is refused whose cells for readings are all empty
NO_READING = "no reading was taken"
#: what `wanted` is where a session should reach what the study's plan would
AS_PLANNED = "plan"
#: share by which a session with the plan's readings may miss the plan's accuracy
ACCURACY_TOLERANCE = 1e-6
POLL_SECONDS = 0.5  #: time between two looks at the file, s


class FittedReadings(NamedTuple):
    """Readings of a file, checked, their fit, and effects that it allows."""

    state: Measured
    estimate: Estimate
    effects: PlannedEffects | None


class Adviser:
    """A study whose candidates, workspace and set-ups are resolved once.

    wanted  rms errors as in "z_um=30"; AS_PLANNED: what the study's plan would reach on
            this machine, as far as it is known after each reading

    Raises InputError where the study has no candidates or no workspace.
    """

    def __init__(self, study: Study, wanted: str = "") -> None:
        self.base = RunState.start(study, None, Silent(), [])
        if not self.base.resolved.candidates:
            raise study.location.key("design").error(
                "the study has no candidates to choose the next reading from",
                "add [[design.candidates]]",
            )
        where = self.base.resolved.prediction
        if where is None:
            raise study.location.key("prediction").error(
                "the study does not say where accuracy counts",
                "add [prediction] with a workspace, see `oed schema study`",
            )
        resolved = self.base.resolved
        self.maps = ErrorMaps.of(
            resolved.measurement.kinematics, where.command, where.table.reference
        )
        self.plan: Sequence[int] = ()
        if wanted == AS_PLANNED:
            chosen = select_design(
                self.base.resolved, Stream.DESIGN.rng(self.base.study.seed)
            )
            if chosen is None:
                problem = "the study chooses no plan to compare with"
                remedy = "add [design] with a number of readings, or state accuracies"
                raise InputError(problem, remedy, field="--wanted", value=AS_PLANNED)
            self.plan = [int(index) for index in chosen.choice.indices]
            wanted = ""
        self.limits = _limits(study, self.base, self.maps.names, wanted)

    def advise(self, readings: Path) -> Advice:
        """The advice after the readings of a file. Raises InputError as they are read."""
        skipped = SkippedPose.from_file(readings, self.everything)
        return self.advise_fitted(self.fit(readings), skipped)

    def watch(self, readings: Path) -> Iterator[list[str]]:
        """Lines of advice, now and after each readable change of the file; without end."""
        last: tuple[int, int] | None = None
        while True:
            status = readings.stat()
            stamp = (status.st_mtime_ns, status.st_size)
            if stamp != last:
                last = stamp
                try:
                    yield self.advice_sentences(self.advise(readings))
                except InputError as error:
                    yield [str(error)]
            time.sleep(POLL_SECONDS)

    @property
    def everything(self) -> Measurement:
        """The machine with all set-ups of the study."""
        return self.base.resolved.measurement_with(self.base.resolved.setups)

    def fit(self, readings: Path) -> FittedReadings | None:
        """The readings of a file with their fit; None without any. Raises InputError."""
        state = self._state_with_readings(readings)
        if state is None:
            return None
        taken = state.readings
        try:
            effects = effects_at(self.base, state.measurement, taken.series)
            estimate = _fit(
                self.base, state.measurement, taken.series, taken.y, effects
            )
        except IdentificationError as error:
            raise state.explained(error) from error
        return FittedReadings(state, estimate, effects)

    def advise_fitted(
        self, fitted: FittedReadings | None, skipped: Sequence[SkippedPose] = ()
    ) -> Advice:
        """Advice after fitted readings, or none; no `skipped` poses. Raises InputError."""
        if fitted is None:
            measurement = self.base.measurement
            effects = effects_at(self.base, measurement, ())
            return self._advise(measurement, (), None, effects, skipped)
        state, estimate, effects = fitted
        series = state.readings.series
        advice = self._advise(state.measurement, series, estimate, effects, skipped)
        checked = () if state.checked is None else state.checked.findings
        section = estimate_section(state.measurement, series, estimate, None)
        return dataclasses.replace(
            advice,
            findings=tuple(finding.sentence for finding in checked),
            objections=tuple(trust.section_objections(state.result.goodness, section)),
        )

    def advise_after(
        self, measurement: Measurement, series: Sequence[Series], y: Array
    ) -> Advice:
        """The advice after readings y (N,), SI, unchecked. Raises IdentificationError."""
        effects = effects_at(self.base, measurement, series)
        estimate = None
        if len(y):
            estimate = _fit(self.base, measurement, series, y, effects)
        return self._advise(measurement, series, estimate, effects)

    def _advise(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        estimate: Estimate | None,
        effects: PlannedEffects | None,
        skipped: Sequence[SkippedPose] = (),
    ) -> Advice:
        theta = measurement.nominal if estimate is None else estimate.theta
        if effects is None:
            candidates = self.base.resolved.candidates
            pool = Candidates.build(measurement, candidates, theta, "tolerance")
            before = self.prior(measurement, pool)
            now = self._belief(measurement, pool, estimate)
            outlook = Outlook(pool, 0, before, now, np.zeros(len(self.maps.names)))
        else:
            outlook = self._outlook_with_effects(measurement, series, theta, effects)
        blocks = outlook.blocks
        if self.plan:
            reached = outlook.before.update_all(blocks, self.plan)
            self.limits = outlook.accuracy(reached) * (1.0 + ACCURACY_TOLERANCE)
        count = sum(map(len, series))
        table = self.base.study.design
        planned = None if table is None else table.size
        remaining = 1 if planned is None else max(planned - count, 1)
        within, passing = outlook.pass_probabilities(self.limits)
        limits = outlook.limits(self.limits if self.plan else passing)
        use = allowed(outlook.pool, outlook.taken, skipped, self.everything)
        places = np.flatnonzero(use)
        plan, more = _plan(outlook.now, blocks[places], remaining, limits)
        chosen = int(places[plan[0]])
        after = outlook.now.after(blocks[chosen])
        of_next, row = outlook.pool.reading(outlook.taken + chosen)
        return Advice(
            names=self.maps.names,
            readings=count,
            known=outlook.accuracy(outlook.now),
            after=outlook.accuracy(after),
            limits=self.limits,
            within=within,
            follows_plan=bool(self.plan),
            candidate=chosen,
            series=of_next,
            row=row,
            expected=measurement.readings([of_next.take(np.array([row]))], theta),
            more=more,
            planned=planned,
            outlook=outlook,
            skipped=tuple(np.flatnonzero(~use).tolist()),
        )

    def _outlook_with_effects(
        self,
        measurement: Measurement,
        taken: Sequence[Series],
        theta: Array,
        effects: PlannedEffects,
    ) -> Outlook:
        """The outlook after the readings taken, linear about theta (n,)."""
        pool = Candidates.build(
            measurement,
            [*taken, *self.base.resolved.candidates],
            theta,
            "tolerance",
            nuisances=effects.readings,
        )
        pool = pool.add_prior(prior_information(measurement))
        count = sum(map(len, taken))
        factors = pool.pose_error_slopes(self.maps.raw, effects.tool)
        by_component = factors.swapaxes(0, 1) / np.sqrt(len(self.maps.raw))
        before, now = (
            Belief.build(np.asarray(np.linalg.inv(total), dtype=float), by_component)
            for total in (pool.prior_information, pool.information(np.arange(count)))
        )
        return Outlook(pool, count, before, now, effects.others, holds_effects=True)

    def accuracy(
        self, measurement: Measurement, pool: Candidates, indices: Sequence[int]
    ) -> Array:
        """Rms (K,) that candidates of a pool reach, without any other reading."""
        prior = self.prior(measurement, pool)
        after = prior.update_all(pool.blocks, indices)
        return np.sqrt(after.variances)

    def prior(self, measurement: Measurement, pool: Candidates) -> Belief:
        """What the tolerances alone say, before any reading."""
        return self._belief(measurement, pool, None)

    def _state_with_readings(self, path: Path) -> Measured | None:
        """The state with the readings of a file; None where it has only poses."""
        resolved = self.base.resolved
        try:
            data = resolved.read_dataset([path])
        except InputError as error:
            if error.problem != NO_READING:
                raise
            return None
        if data is None:
            return None
        state = self.base.replace(
            resolved=resolved.with_dataset(data), readings_given=True
        )
        measured = checked(state, data)
        # Candidates may need set-ups that no reading has used yet.
        used = {*measured.measurement.setups, *self.base.measurement.setups}
        return measured.replace(measurement=resolved.measurement_with(used))

    def _belief(
        self, measurement: Measurement, pool: Candidates, estimate: Estimate | None
    ) -> Belief:
        """Covariance in tolerances; errors that runs share have variance 1."""
        free = measurement.free
        scale = measurement.tolerance[free]
        columns = len(scale) + pool.shared_errors
        covariance = np.eye(columns)
        correlation = measurement.correlation
        if correlation is not None:
            covariance[: len(scale), : len(scale)] = correlation[np.ix_(free, free)]
        if estimate is not None:
            identified = estimate.covariance[np.ix_(free, free)]
            covariance[: len(scale), : len(scale)] = identified / np.outer(scale, scale)
        count = len(measurement.machine.parameters)
        poses, components, _ = self.maps.raw.shape
        slopes = np.zeros((components, poses, len(free)))
        slopes[:, :, :count] = self.maps.raw.swapaxes(0, 1) / np.sqrt(poses)
        factors = np.zeros((components, poses, columns))
        factors[:, :, : len(scale)] = slopes[:, :, free] * scale
        return Belief.build(covariance, factors)

    def advice_sentences(self, advice: Advice) -> list[str]:
        """The advice in lines: what is known, the next reading, when to stop."""
        machine = self.base.resolved.machine
        fine = {c.name: units.FINE[c.unit] for c in machine.components}
        lines = [
            f"{advice.readings} readings taken. Rms error over the workspace, unknown part:"
        ]
        for k, name in enumerate(advice.names):
            unit = fine[name]
            now, then = (units.number(v[k], unit) for v in (advice.known, advice.after))
            sizes = f"{format_number(now):>8} {unit:<7} {format_number(then):>8}"
            line = f"  {name:<6} {sizes} after the next reading"
            if np.isfinite(advice.limits[k]):
                wanted = format_number(units.number(advice.limits[k], unit))
                line += f"   wanted {wanted}{_stated(advice, k)}"
            lines.append(line)
        skipped = skips(advice)
        return [
            *advice.findings,
            *lines,
            *advice.stop_sentences(),
            *skipped,
            *_next(self, advice),
        ]


def _plan(
    belief: Belief, blocks: Array, remaining: int, limits: Array
) -> tuple[list[int], int | None]:
    """Readings to come, at least the fewest that reach what is wanted, and how many do."""
    if np.isfinite(limits).any():
        fewest = belief.fewest_remaining(blocks, remaining, limits)
        if fewest is not None and fewest[0]:
            return fewest
        remaining = remaining if fewest is None else 1  # all is reached: no more plans
    plan = belief.best_remaining(blocks, remaining, limits)
    return plan, _more(belief, blocks, plan, limits)


def _more(belief: Belief, blocks: Array, plan: list[int], limits: Array) -> int | None:
    """Readings of the plan, then others, until all that is wanted is reached; or None."""
    if not np.isfinite(limits).any():
        return None
    rest = list(plan)
    for number in range(MAX_AHEAD + 1):
        if not belief.open_components(limits):
            return number
        pool = blocks[rest] if rest else blocks
        best = belief.best_candidate(pool, limits)
        belief = belief.after(pool[best])
        if rest:
            rest.pop(best)
    return None


def _limits(
    study: Study, state: RunState, names: tuple[str, ...], wanted: str
) -> Array:
    """Wanted rms (K,), SI: of the option, else of the study; NaN where none is."""
    machine = state.resolved.machine
    values = component_values(wanted, "--wanted", machine)
    if not wanted:
        if study.design is not None and study.design.how_many is not None:
            table = study.design.how_many.wanted
            location = study.location.path("design", "how_many", "wanted")
            unit_of = {c.name: c.unit for c in machine.components}
            values = quantities.read_values(table, unit_of, location)
        values |= state.resolved.wanted_accuracy
    return np.array([values.get(name, np.nan) for name in names])


def _fit(
    state: RunState,
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    effects: PlannedEffects | None,
) -> Estimate:
    """The fit; all parameters at once where few readings fail to find a start."""
    noise = None
    if effects is not None:
        structure = reading_structure(measurement, series, measurement.nominal)
        changes = effects.readings.take(slice(0, len(structure)))
        columns = np.hstack([changes.columns, np.diag(changes.scatter)])
        wider = dataclasses.replace(structure, effects=structure.standardise(columns))
        noise = Laws.stated(wider).noise(wider)
    most = state.study.identify.max_iterations
    stages = state.resolved.identification_stages
    try:
        return identify(
            measurement, series, y, stages=stages, max_iterations=most, noise=noise
        )
    except IdentificationError:
        if len(stages) == 1:
            raise
        return identify(measurement, series, y, max_iterations=most, noise=noise)


# The advice at the machine, and its sentences: what is known, what to read, when to stop.

#: readings that are thought ahead, to say how many reach what is wanted
MAX_AHEAD = 100
#: share of the error below which a further reading is not worth its time
MIN_GAIN = 0.01
EVERY = "every wanted accuracy"
GEOMETRY_SO_FAR = (
    "Geometry alone so far: every wanted accuracy would be reached if no effect acted"
    " beside it. Evaluate the readings to learn whether one does (`oed identify`)."
)


@dataclasses.dataclass(frozen=True)
class Advice:
    """What a user at the machine needs to know after a reading."""

    names: tuple[str, ...]
    readings: int  #: number taken
    known: Array  #: rms (K,) of each component over the workspace, SI, its unknown part
    after: Array  #: the same after the next reading
    limits: Array  #: wanted rms (K,), SI; NaN where none is
    #: probability (K,) that the rms error of this machine is within what is wanted; NaN
    #: where nothing is
    within: Array
    follows_plan: bool  #: whether the limits are what the study's plan would reach
    #: number of the next reading among the candidates, which is in a row of a series;
    #: `expected` is what it should read, SI
    candidate: int
    series: Series
    row: int
    expected: Array
    #: readings that reach what is wanted, one after another; None where `MAX_AHEAD` do
    #: not, or nothing is wanted
    more: int | None
    planned: int | None  #: readings of the study's plan, if it states a number
    #: all candidates, and what is known, from which the next one is chosen
    outlook: Outlook
    findings: tuple[str, ...] = ()  #: what a check of the readings says
    objections: tuple[str, ...] = ()  #: why nothing should rest on the readings so far
    skipped: tuple[int, ...] = ()  #: numbers of the candidates that are not advised

    def judgement(self, component: int) -> Judgement:
        """The verdict on one component's wanted accuracy."""
        can_pass = self.outlook.holds_effects and not self.objections
        return judge(float(self.within[component]), can_pass=can_pass)

    @property
    def is_reached(self) -> bool:
        """Whether every wanted accuracy passes, or what the plan would reach is reached."""
        wanted = np.flatnonzero(np.isfinite(self.limits))
        if self.follows_plan:
            return not self.objections and bool((self.known <= self.limits).all())
        return overall(self.judgement(int(k)) for k in wanted) == "pass"

    @property
    def is_reached_by_geometry(self) -> bool:
        """Whether all would pass if nothing beside the geometry acted."""
        stated = self.within[np.isfinite(self.limits)]
        passes = bool(stated.size and (stated >= SURE_PROBABILITY).all())
        return passes and not self.outlook.holds_effects and not self.follows_plan

    @property
    def gain(self) -> float:
        """Share by which the next reading lowers the errors, on average."""
        positive = self.known > 0.0
        ratios = self.after[positive] / self.known[positive]
        return float(1.0 - np.exp(np.mean(np.log(ratios)))) if ratios.size else 0.0

    def stop_sentences(self) -> list[str]:
        """Whether to stop now, and how far it is."""
        if self.objections:
            return [
                f"Look for the cause before you go on: {'; '.join(self.objections)}."
            ]
        if self.is_reached:
            reached = "what the plan would reach" if self.follows_plan else EVERY
            return [f"Stop: {reached} is reached."]
        if self.is_reached_by_geometry:
            return [GEOMETRY_SO_FAR]
        if np.isfinite(self.limits).any():
            if self.more is None:
                return [f"{MAX_AHEAD} more readings would not reach what is wanted."]
            if self.more == 1:
                return ["About 1 more reading reaches what is wanted."]
            return [f"About {self.more} more readings reach what is wanted."]
        if self.planned is not None and self.readings >= self.planned:
            return [f"Stop: the {self.planned} readings of the plan are taken."]
        if self.readings and self.gain < MIN_GAIN:
            return [f"Stop: a further reading gains less than {100 * MIN_GAIN:.0f} %."]
        if self.planned is None:
            return []
        return [f"The plan has {self.planned} readings."]


def _stated(advice: Advice, component: int) -> str:
    """The verdict on a component; what a plan would reach has none."""
    if advice.follows_plan:
        return ""
    within = format_probability(float(advice.within[component]))
    return f": {advice.judgement(component)} (within it with {within})"


def skips(advice: Advice) -> list[str]:
    """How many readings are not advised, as their poses are skipped."""
    count = len(advice.skipped)
    if not count:
        return []
    phrase = "1 reading is" if count == 1 else f"{count} readings are"
    return [f"{phrase} not advised: the file's remarks skip the pose."]


def _next(adviser: Adviser, advice: Advice) -> list[str]:
    """Set-up, command, joints and the value that the reading should have."""
    machine = adviser.base.resolved.machine
    series, row = advice.series, advice.row
    command = describe.displayed_command(machine, series.reading_commands()[row])
    joints = describe.displayed_joints(machine, series.q[series.index[row, 0]])
    setup = adviser.base.resolved.setups[series.setup]
    expected = [
        f"{channel.name} {quantities.format_value(float(value), channel.unit)}"
        for channel, value in zip(
            setup.instrument.channels, advice.expected, strict=True
        )
    ]
    return [
        f"Next: {series.setup}, {_values(command)}; joints {_values(joints)}.",
        f"It should read {', '.join(expected)} and lowers the errors by"
        f" {100.0 * advice.gain:.2g} % on average.",
    ]


def _values(numbers: dict[str, float]) -> str:
    return ", ".join(f"{key} = {value:.7g}" for key, value in numbers.items())


# Reads the second visit that a diagnosis advises from its result, in lines.
def visit_lines(study: Study, named: Path, folder: Path) -> list[str]:
    """What the visit is worth, its runs, and the file to fill in.

    named   the study as the user gave it: its path, or the name of a shipped one
    folder  that of the diagnosis

    Raises InputError where the folder holds no diagnosis of this study.
    """
    result = load_result(folder)
    gap = _diagnosis(study, result, folder)
    visit = gap.second_visit
    if visit is None:
        return [
            "No second visit is advised: the first answer is sure, or no run of those"
            " read so far makes it clearer.",
            *gap.next,
        ]
    table = str(folder / VISIT)
    phrases = ["diagnose", str(named), "--readings", table, "--after", str(folder)]
    return [
        *visit.words,
        "",
        *(
            f"  {run.setup}: {run.run}: {count} poses{_condition(run)}"
            for run, count in zip(visit.runs, visit.poses, strict=True)
        ),
        "",
        f"Fill in {table}, then: oed {shlex.join(phrases)} --out DIR",
    ]


def _diagnosis(study: Study, result: StudyResult, folder: Path) -> GapSection:
    if result.gap is None or result.study != study.name:
        content = "no diagnosis" if result.gap is None else f"study {result.study}"
        problem = f"that is not a diagnosis of {study.name}: {content}"
        remedy = "name a folder that `oed diagnose` wrote for this study"
        raise InputError(problem, remedy, field="--after", value=str(folder))
    return result.gap


def _condition(run: ChosenRun) -> str:
    condition, phrases = run.condition, []
    if "direction" in condition:
        phrases.append(f"direction {condition['direction']:+.0f}")
    if "feed" in condition:
        phrases.append(f"{condition['feed'] / units.MM_PER_MIN:g} mm/min")
    if "payload" in condition:
        phrases.append(f"{condition['payload']:g} N")
    return f" ({', '.join(phrases)})" if phrases else ""


# Poses that an operator has skipped, from the remarks of a readings file.

#: largest difference of a written command, mm or deg: twice its last digit
WRITTEN_STEP: Final = 2e-4

SKIPPED: Final = "skipped"  #: how the remark of a skipped pose begins


class SkippedPose(NamedTuple):
    """A pose that is not advised: a set-up, and a command (n_dof,), SI."""

    setup: str
    command: Array

    @staticmethod
    def remark(reason: str) -> str:
        """The remark of a row whose pose is skipped for a reason, or for none."""
        return f"{SKIPPED}: {reason}" if reason else SKIPPED

    @classmethod
    def from_file(cls, path: Path, measurement: Measurement) -> list[SkippedPose]:
        """Skipped poses of a file; none of one that is no table, as its readings say."""
        try:
            split = SplitText.of(decode(path.read_bytes()))
            lines = [cells for _, cells in split.rows()]
        except (UnicodeDecodeError, csv.Error):
            return []
        header = [name.strip() for name in lines[0]] if lines else []
        rows = (dict(zip(header, cells, strict=False)) for cells in lines[1:])
        return list(cls.from_rows(rows, measurement))

    @classmethod
    def from_rows(
        cls, rows: Iterable[Mapping[str, str]], measurement: Measurement
    ) -> Iterator[SkippedPose]:
        """Skipped poses of rows, cells by column."""
        for cells in rows:
            pose = _pose(cells, measurement) if cls.is_in(cells, measurement) else None
            if pose is not None:
                yield cls(cells["setup"].strip(), pose)

    @staticmethod
    def is_in(cells: Mapping[str, str], measurement: Measurement) -> bool:
        """Whether a row of a known set-up has no reading, and a remark that says skipped."""
        setup = measurement.setups.get(cells.get("setup", "").strip())
        remarks = [cell for name, cell in cells.items() if is_remark(name)]
        if setup is None or not any(
            remark.strip().casefold().startswith(SKIPPED) for remark in remarks
        ):
            return False
        read = {c.name for c in setup.instrument.channels}
        if setup.instrument.implied is not None:
            read |= {joint.name for joint in measurement.machine.joints}
        return not any(
            cell.strip() and ReadingsColumn.stem_of(name) in read
            for name, cell in cells.items()
        )


def allowed(
    pool: Candidates,
    taken: int,
    skipped: Sequence[SkippedPose],
    measurement: Measurement,
) -> Mask:
    """Mask (C,) of candidates at no skipped pose. Raises InputError where none is left."""
    rows = [~_is_at_any(series, skipped, measurement) for series in pool.series]
    mask = np.concatenate(rows)[pool.members[taken:, 0]]
    if not mask.any():
        raise InputError(
            "every candidate is skipped",
            "clear a remark that begins with skipped, or add candidates to the study",
        )
    return np.asarray(mask)


def _is_at_any(
    series: Series, skipped: Iterable[SkippedPose], measurement: Measurement
) -> Mask:
    """Mask (n,) of the readings of a series at a skipped pose."""
    coordinates = measurement.machine.workspace(measurement.setups[series.setup].tool)
    near = WRITTEN_STEP * np.array(
        [ReadingsColumn.of(c.name, c.unit).factor for c in coordinates]
    )
    commands = series.reading_commands()
    mask = np.zeros(len(series), dtype=bool)
    for setup, pose in skipped:
        if setup == series.setup:
            mask |= (np.abs(commands - pose) <= near).all(axis=1)
    return mask


def _pose(cells: Mapping[str, str], measurement: Measurement) -> Array | None:
    """The command of a row, SI; None where the row does not have all of it."""
    setup = measurement.setups[cells["setup"].strip()]
    written = {
        ReadingsColumn.stem_of(name): (name, cell) for name, cell in cells.items()
    }
    values = []
    for coordinate in measurement.machine.workspace(setup.tool):
        name, cell = written.get(coordinate.name, ("", ""))
        try:
            number = float(cell.strip().replace(",", "."))
        except ValueError:
            return None
        values.append(number * ReadingsColumn.parse(name).factor)
    return np.array(values)
