"""The design as a section of the result: its certificate in words, given plans scored
beside it, its poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed import criteria, explain, result
from oed.measurement import Measurement, Series
from pkm_studies.resolve import quantities
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages import describe
from pkm_studies.stages.design import select as choose
from pkm_studies.stages.design.criteria import (
    EIGENVALUES,
    StudyCriteria,
    improvement_factors,
)
from pkm_studies.stages.design.select import ChosenDesign
from pkm_studies.stages.headline import percent


def design_section(
    resolved: ResolvedStudy, chosen: ChosenDesign, seen: explain.Seen
) -> result.DesignSection:
    """The design with the given plans scored beside it."""
    design, choice, aims = chosen.aims.design, chosen.choice, chosen.aims
    plans = _plans(resolved, chosen, seen)
    moved = (
        chosen.polished
        if chosen.polished and chosen.polished.after != chosen.polished.before
        else None
    )
    polished = moved is not None
    shared = choice.columns - int(resolved.measurement.free.sum())
    return result.DesignSection(
        criterion=design.judged_by,
        n=plans[0].n,
        value=moved.after if moved else plans[0].value if chosen.kept else choice.value,
        bound=None if polished else choice.bound,
        efficiency=None if polished else choice.efficiency,
        kappa=plans[0].kappa,
        observability=plans[0].observability,
        poses=planned_readings(chosen.measurement, chosen.scheduled),
        scaling=design.scaling,
        candidates=chosen.candidates,
        plans=plans,
        words=certificate_text(chosen, shared),
        directions=choice.directions - max(shared, 0),
        columns=choice.columns - max(shared, 0),
        gap=None if polished else choice.duality_gap,
        proven=choice.proven and not polished,
        compound=dict(aims.design.compound),
        setups=chosen.order.setups,
        retained=chosen.kept,
        cost_min=choose.plan_seconds(chosen.measurement, chosen.series) / 60.0,
        refused=dict(resolved.refusals),
        compared=list(chosen.compared),
        polished=chosen.polished,
        order=chosen.order,
        robust=chosen.robust,
        how_many=chosen.how_many,
    )


def certificate_text(chosen: ChosenDesign, shared: int = 0) -> str:
    """How good the choice is known to be, in one sentence or two."""
    choice = chosen.choice
    kind = "runs" if chosen.aims.design.whole_runs else "readings"
    what = f"{len(choice.indices)} of {chosen.candidates} {kind}"
    if chosen.robust is not None:
        told = _sturdy(chosen.robust, what)
    elif choice.proven:
        told = (
            f"Proven optimal: no other choice of {what} is better by {choice.criterion}"
        )
    elif choice.efficiency is not None:
        told = (
            f"Certified to {percent(choice.efficiency)} % of the best possible {what}"
        )
        if chosen.loose:
            told += (
                " (a bound that lets any number of set-ups be mounted: the choice is"
                " better than this tells)"
            )
        elif choice.duality_gap is not None and choice.duality_gap > 0.01:
            told += (
                f" (the bound itself may be {100 * choice.duality_gap:.0f} % too high: the"
                " choice is better than this tells)"
            )
    else:
        told = (
            f"The best {what} that were found; no bound is known for {choice.criterion}"
            " under these rules"
        )
    seen, columns = choice.directions - max(shared, 0), choice.columns - max(shared, 0)
    if seen < columns:
        told += (
            f", over the {seen} of {columns} directions that the candidates see (the"
            " identifiable subspace)"
        )
    asked = chosen.aims.design.size
    if (
        asked is not None
        and len(choice.indices) < asked
        and chosen.aims.design.budget_min is None
    ):
        told += f"; {asked} were asked for, but the rules leave no room for more"
    if chosen.kept:
        told += f", beside {chosen.kept} readings kept"
    return f"{told}." + (
        f" Then, off the grid, {chosen.polished.words}."
        if chosen.polished is not None
        else ""
    )


def _sturdy(robust: result.RobustSummary, what: str) -> str:
    risk = {
        "mean": "on average",
        "cvar": f"over the worst {percent(robust.level)} %",
        "worst": "for the worst one",
    }
    more = 100.0 * (np.exp(robust.value - robust.nominal) - 1.0)
    return (
        f"Chosen for {robust.scenarios} machines drawn from the tolerances,"
        f" {risk[robust.risk]}: certified to {percent(robust.efficiency)} % of the best"
        f" possible {what} for them, {more:.1f} % better there than the plan for the"
        " nominal machine"
    )


# -- plans -----------------------------------------------------------------------------


def _plans(
    resolved: ResolvedStudy, chosen: ChosenDesign, seen: explain.Seen
) -> list[result.PlanScore]:
    """The chosen plan and the given ones that can be compared with it: those that see
    as much, or, where tolerances count, all.
    """
    aims = chosen.aims
    found = [("chosen", chosen.measurement, seen)]
    for plan in resolved.reference_plans:
        m = resolved.measurement_with(plan.setups)
        other = explain.look(m, plan.series, aims.design.scaling)
        alike = (
            set(plan.setups) <= set(resolved.measurement.setups)
            and other.verdict.rank == seen.verdict.rank
        )
        if aims.design.prior or alike:
            found.append((plan.name, m, other))
    first: Mapping[str, float] = {}
    made: list[result.PlanScore] = []
    phis: list[float] = []
    for name, m, look in found:
        predicted = aims.predicted(m, look.series)
        first = predicted if len(made) == 1 else first
        own, every = _columns(resolved, aims, m)
        value = aims.judged(aims.design.judged_by, own, look.series)[1]
        phis.append(aims.judged(aims.design.judged_by, every, look.series)[0])
        made.append(_score(name, look, aims, value, predicted))
    return [
        _against(p, made[0], phi - phis[0], aims, first)
        for p, phi in zip(made, phis, strict=True)
    ]


def _columns(
    resolved: ResolvedStudy, aims: StudyCriteria, m: Measurement
) -> tuple[Measurement, Measurement]:
    """Measurements by which a plan's value is told, and by which it is compared with
    others.

    Where tolerances count, so do those of set-ups that are not used: of the candidates'
    in the value, of all plans' in comparisons. Criteria of eigenvalues, and plans
    without tolerances, are judged over what their own readings concern.
    """
    if not aims.design.prior or set(aims.design.criteria) & set(EIGENVALUES):
        return m, m
    made = []
    for others in ([], [n for plan in resolved.reference_plans for n in plan.setups]):
        wide = resolved.measurement_with(
            [*resolved.measurement.setups, *m.setups, *others]
        )
        made.append(Measurement(m.machine, list({**wide.setups, **m.setups}.values())))
    return made[0], made[1]


def _score(
    name: str,
    seen: explain.Seen,
    aims: StudyCriteria,
    value: float,
    predicted: dict[str, float],
) -> result.PlanScore:
    s = seen.verdict.identifiable
    n = sum(len(x) for x in seen.series)
    held = 1.0 if aims.design.prior else 0.0
    return result.PlanScore(
        name=name,
        n=n,
        criterion=aims.design.judged_by,
        value=value,
        logdet=float(np.log(s**2 + held).sum()),
        efficiency=1.0,
        kappa=criteria.kappa(s),
        observability=criteria.observability(s, n),
        predicted=predicted,
    )


def _against(
    plan: result.PlanScore,
    best: result.PlanScore,
    phi: float,
    aims: StudyCriteria,
    first: Mapping[str, float],
) -> result.PlanScore:
    """With its efficiency against the chosen plan, and its gain against the first given
    one.
    """
    grows = not set(aims.design.criteria) & {
        "kappa",
        "O2",
        "O4",
    }  # ratios of eigenvalues do not
    per_reading = best.n / plan.n if grows and not aims.design.prior else 1.0
    return result.PlanScore(
        name=plan.name,
        n=plan.n,
        criterion=plan.criterion,
        value=plan.value,
        logdet=plan.logdet,
        efficiency=float(np.exp(phi)) * per_reading,
        kappa=plan.kappa,
        observability=plan.observability,
        predicted=plan.predicted,
        gain=improvement_factors(first, plan.predicted) if first else {},
    )


def planned_readings(
    measurement: Measurement, series: Sequence[Series]
) -> list[result.PlannedReading]:
    """The readings as poses to command, in working order."""
    table = []
    nominal = measurement.nominal
    for s in series:
        channels = measurement.setups[s.setup].instrument.channels
        y = measurement.readings([s], nominal).reshape(len(s), len(channels))
        seen: dict[str, int] = {}
        for k, run in enumerate(s.run):
            seen[run] = seen.get(run, 0) + 1
            read = {
                quantities.column(c.name, c.unit): describe.shown(float(v), c.unit)
                for c, v in zip(channels, y[k], strict=True)
            }
            table.append(
                result.PlannedReading(
                    s.setup,
                    str(run),
                    seen[run],
                    describe.command(measurement.machine, s.commands()[k]),
                    read,
                )
            )
    return table
