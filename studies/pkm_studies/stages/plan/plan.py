"""The step-calibration plan: which measurement at which stage, within a time; the
search, and what it comes to.

The kernel is `oed.planning`. Here its answer becomes a section of the result: what each
stage sees and leaves, what the plan would need to be enough (`plan_words`), and
sequences that were asked for beside the best plan of their time (`plan_compared`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from oed import criteria, explain, predict, result, units
from oed.arrays import Array
from oed.measurement import Measurement, Series
from oed.planning import goal as goals
from oed.planning import search
from oed.planning.goal import Goal
from oed.planning.option import Option
from oed.planning.search import Planned, StagePlan
from oed.planning.stage import Stage
from pkm_studies.errors import Place
from pkm_studies.progress import Progress
from pkm_studies.resolve.plan import PlanAsked
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.design import order
from pkm_studies.stages.plan.learned import Learned
from pkm_studies.study.tables import DesignTable
from pkm_studies.study.tables import PlanTable as Said

#: share of its standard deviation before above which a parameter counts as not told
HELD = 0.95
#: a loss that any plan keeps: its bound is a single line
ANY = 1e6


@dataclasses.dataclass(frozen=True, kw_only=True)
class Made:
    """The plan with its readings in working order: of each stage, as the result tells
    them, and all together.
    """

    section: result.PlanSection
    measurement: Measurement
    series: tuple[Series, ...]
    scheduled: tuple[tuple[Series, ...], ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Task:
    """What to plan: options and goal; `everything` tells all components, whatever is
    wanted.

    start (n, n) covariance of the machine's free parameters before, in units of their
    tolerances
    """

    resolved: ResolvedStudy
    said: Said
    asked: PlanAsked
    goal: Goal
    everything: Goal
    start: Array
    budget: float
    seed: Sequence[int]

    @property
    def place(self) -> Place:
        """The table, for errors."""
        return self.resolved.study.place.key("plan")

    def search(
        self,
        budget: float | None = None,
        *,
        stages: int | None = None,
        beam: int = search.BEAM,
        loss: float = 0.05,
        options: Sequence[Option] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Planned:
        """The best plan; the study's time and number of stages where nothing else is
        told. Raises ValueError.
        """
        return search.plan(
            self.asked.options if options is None else options,
            self.goal,
            self.budget if budget is None else budget,
            np.random.default_rng(self.seed),
            covariance=self.start,
            stages=self.said.stages if stages is None else stages,
            beam=beam,
            loss=loss,
            progress=progress,
        )

    def accuracy(self, covariance: Array) -> dict[str, float]:
        """Root mean square of each component over the workspace, in its fine unit."""
        fine = {c.name: units.FINE[c.unit] for c in self.resolved.machine.components}
        told = self.everything.accuracy(covariance) * self.everything.unit
        return {
            f"{n}_{fine[n]}": units.number(float(v), fine[n])
            for n, v in zip(self.everything.names, told, strict=True)
        }

    def left(self, plan: StagePlan) -> Array:
        """Covariance after a plan."""
        return plan.stages[-1].covariance if plan.stages else self.start

    def way(self, plan: StagePlan, why: str = "") -> result.AlternativePlan:
        """A plan in short."""
        return result.AlternativePlan(
            names=list(plan.names),
            readings=[len(s.chosen) for s in plan.stages],
            minutes=plan.seconds / 60.0,
            value=plan.value,
            accuracy=self.accuracy(self.left(plan)),
            why=why,
        )


def plan(
    resolved: ResolvedStudy,
    seed: Sequence[int],
    machines: np.random.Generator,
    progress: Progress,
    known: Learned | None,
) -> Made | None:
    """The plan that the study asks for; None where it lists no measurement. Raises
    InputError where none is possible.

    `known`: what was learned and done before; `resolved` is then that of the machine as
    it is believed to be.
    """
    if resolved.plan is None:
        return None
    from pkm_studies.stages.plan import compared as plan_compared
    from pkm_studies.stages.plan import words as plan_words

    task = _task(resolved, resolved.plan, seed, known)
    try:
        found = task.search(progress=progress.share)
    except ValueError as error:
        remedy = (
            "give more time, or list fewer measurements or stages"
            if task.asked.options
            else "plan no further"
        )
        if task.asked.reserved:
            remedy += (
                f" ({task.asked.reserved / 60.0:g} min of it are for [gap.design])"
            )
        raise task.place.key("budget_min").error(
            str(error), remedy, task.said.budget_min
        ) from error
    best = _worthwhile(task, found)
    section, arranged, measurement = _section(task, found, best)
    realised = _virtual(
        task,
        best,
        section.stages,
        machines,
        progress,
        None if known is None else known.covariance,
    )
    section = msgspec.structs.replace(
        section,
        stages=realised,
        virtual_machines=task.said.virtual_machines,
        alternatives=list(plan_words.alternatives(task, found, best)),
        needs=plan_words.needs(task, found),
        stop=plan_words.stop(task, found, best),
        compared=[
            plan_compared.compared(task, names, found) for names in task.asked.compare
        ],
        after="" if known is None else known.words,
    )
    return Made(
        section=section,
        measurement=measurement,
        series=tuple(s for a in arranged for s in a.series),
        scheduled=tuple(a.scheduled for a in arranged),
    )


def _task(
    resolved: ResolvedStudy,
    asked: PlanAsked,
    seed: Sequence[int],
    known: Learned | None,
) -> Task:
    study, command = resolved.study, resolved.prediction_commands
    assert study.plan is not None
    assert study.prediction is not None
    assert command is not None
    base = resolved.measurement_with(())
    maps = predict.error_maps(base.kinematics, command, study.prediction.reference)
    everything = goals.goal_of(base, maps, {})
    n = everything.factors.shape[2]
    return Task(
        resolved=resolved,
        said=study.plan,
        asked=asked,
        goal=(
            goals.goal_of(base, maps, dict(asked.wanted))
            if asked.wanted
            else everything
        ),
        everything=everything,
        start=np.eye(n) if known is None else known.covariance,
        budget=asked.budget - (0.0 if known is None else known.seconds),
        seed=seed,
    )


def _worthwhile(task: Task, found: Planned) -> StagePlan:
    """The plan, without last stages that are not worth it: a plan of fewer stages that
    is nearly as accurate.
    """
    best = found.best
    while task.said.worth and not task.goal.wanted and len(best.stages) > 1:
        shorter = task.search(stages=len(best.stages) - 1, loss=ANY).best
        if 1.0 - best.value / shorter.value >= task.said.worth:
            break
        best = shorter
    return best


# -- the plan as a section -------------------------------------------------------------


def _section(
    task: Task, found: Planned, best: StagePlan
) -> tuple[result.PlanSection, list[order.Arranged], Measurement]:
    stages: list[result.StageRecord] = []
    arranged: list[order.Arranged] = []
    clock = 0.0
    for k, stage in enumerate(best.stages):
        ordered = _arranged(task, stage, k)
        sofar = task.resolved.measurement_with(
            {s.setup for a in [*arranged, ordered] for s in a.series}
        )
        arranged.append(ordered)
        readings = [s for a in arranged for s in a.series]
        stages.append(
            _stage(task, stage, ordered, clock, explain.look(sofar, readings))
        )
        clock += stage.seconds / 60.0
    told = result.PlanSection(
        stages=stages,
        cost=best.seconds / 60.0,
        alternatives=[],
        budget_min=task.budget / 60.0,
        price=best.price,
        value=best.value,
        goal=dict(task.said.wanted),
        reached=found.reached,
        start_accuracy=task.accuracy(task.start),
        accuracy=task.accuracy(task.left(best)),
        best_reachable=task.accuracy(task.left(found.most_accurate)),
        bound=found.bound.value,
        loss=max(
            (found.most_accurate.value if task.goal.wanted else best.value)
            / found.bound.value
            - 1.0,
            0.0,
        ),
        lines=found.bound.lines,
        front=[task.way(p) for p in found.front],
    )
    return (
        told,
        arranged,
        task.resolved.measurement_with({s.setup for a in arranged for s in a.series}),
    )


def _arranged(task: Task, stage: Stage, number: int) -> order.Arranged:
    """A stage's readings in working order, by what [design.order] says of speeds and
    re-mounting.
    """
    study = task.resolved.study
    table = next(t for t in task.said.measurement if t.name == stage.option.name)
    usual = study.design.order if study.design else DesignTable().order
    ordering = dataclasses.replace(
        task.resolved,
        study=msgspec.structs.replace(
            study, design=DesignTable(order=usual, whole_runs=table.whole_runs)
        ),
    )
    rng = np.random.default_rng([*task.seed, number])
    return order.arrange(ordering, stage.option.measurement, (), stage.series, rng)


def _stage(
    task: Task, stage: Stage, ordered: order.Arranged, begin: float, sofar: explain.Seen
) -> result.StageRecord:
    own = explain.look(stage.option.measurement, stage.series)
    lengths = stage.cut_off[_lengths(stage)]
    told = task.accuracy(stage.covariance)
    return result.StageRecord(
        measurement=stage.option.name,
        setups=ordered.told.setups,
        readings=sum(len(s) for s in stage.series),
        identifies=own.verdict.rank,
        cost=stage.seconds / 60.0,
        kappa=criteria.kappa(own.verdict.identifiable),
        predicted=told,
        chosen=len(stage.chosen),
        begin_min=begin,
        end_min=begin + stage.seconds / 60.0,
        price=stage.option.price,
        operator=stage.option.operator,
        available={
            "least": float(stage.available.min()),
            "mean": float(stage.available.mean()),
        },
        lost=float((1.0 - stage.available).sum()),
        cut_off_um=(
            float(1e6 * lengths.max())
            if lengths.size and np.isfinite(lengths.max())
            else None
        ),
        rank=sofar.verdict.rank,
        parameters=_parameters(stage),
        unidentified=_held(task, stage, sofar),
        accuracy=told,
    )


def _lengths(stage: Stage) -> Array:
    """Which numbers of a stage's readings (N,) are lengths."""
    setups = stage.option.measurement.setups
    kinds = [
        [c.unit == "m" for c in setups[s.setup].instrument.channels] * len(s)
        for s in stage.series
    ]
    return np.concatenate([np.array(k, dtype=bool) for k in kinds])


def _free(stage: Stage) -> tuple[list[str], Array, list[str]]:
    """Names, tolerances (n,) and SI units of the machine's free parameters."""
    m, n = stage.option.measurement, len(stage.option.measurement.machine.parameters)
    rows = np.flatnonzero(m.free[:n])
    return (
        [m.names[k] for k in rows],
        m.tolerance[rows],
        [m.parameters[k].unit for k in rows],
    )


def _parameters(stage: Stage) -> dict[str, result.Sd]:
    names, tolerance, kinds = _free(stage)
    sd = np.sqrt(np.diag(stage.covariance)) * tolerance
    shown = [units.display(u) for u in kinds]
    return {
        n: result.Sd(units.number(float(v), u), u)
        for n, v, u in zip(names, sd, shown, strict=True)
    }


def _held(task: Task, stage: Stage, sofar: explain.Seen) -> list[str]:
    """Parameters still as wide as before any reading, and combinations of them that no
    reading so far sees.
    """
    names, _, _ = _free(stage)
    share = np.sqrt(np.diag(stage.covariance) / np.diag(task.start))
    alone = [n for n, s in zip(names, share, strict=True) if s > HELD]
    kind = {p.name: p.unit for p in sofar.measurement.parameters}
    lost = [
        terms
        for terms in sofar.verdict.named(sofar.verdict.lost)
        if set(terms) <= set(names) and not set(terms) <= set(alone)
    ]
    return [*alone, *(explain.combination(terms, kind) for terms in lost)]


def _virtual(
    task: Task,
    best: StagePlan,
    stages: list[result.StageRecord],
    rng: np.random.Generator,
    progress: Progress,
    start: Array | None,
) -> list[result.StageRecord]:
    """The stages with what virtual machines make of them, drawn from what was learned
    (`start`), or the tolerances.
    """
    if not task.said.virtual_machines:
        return stages
    from oed.planning import campaign

    progress.stage("virtual machines through the plan")
    assert task.resolved.prediction_commands is not None
    assert task.resolved.study.prediction is not None
    checked = campaign.carry_out(
        best.stages,
        task.resolved.prediction_commands,
        task.said.virtual_machines,
        rng,
        reference=task.resolved.study.prediction.reference,
        start=start,
        progress=progress.share,
    )
    told = []
    for stage, seen in zip(stages, checked.stages, strict=True):
        ratio = dict(zip(checked.names, seen.ratio, strict=True))
        realised = {n: float(v) for n, v in ratio.items() if np.isfinite(v)}
        lost = seen.lost * (stage.chosen or 0)
        told.append(
            msgspec.structs.replace(
                stage, realised=realised, realised_lost=lost, coverage=seen.held
            )
        )
    return told
