"""Reports the design: the section `design`, with plan scores and poses to command."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import msgspec
import numpy as np

from oed.base.text import guaranteed_percent
from oed.identifiability.assessment import Assessment
from oed.measurement.measurement import Measurement, Series
from oed.result import AllowedEffects, DesignSection, PlannedReading, RobustSummary
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.describe import (
    displayed_command,
    displayed_joints,
    displayed_values,
)
from pkm_studies.stages.design import effects
from pkm_studies.stages.design.cost import plan_seconds
from pkm_studies.stages.design.plan_scores import plan_scores
from pkm_studies.stages.design.select import ChosenDesign

#: slack of the bound (log of an efficiency) from which it is worth saying
SLACK = 0.01


def design_section(
    resolved: ResolvedStudy, chosen: ChosenDesign, identifiability: Assessment
) -> DesignSection:
    """The chosen plan with its certificate, scored with the reference plans."""
    table, choice, polish = chosen.criteria.table, chosen.choice, chosen.polish
    scores = plan_scores(resolved, chosen, identifiability)
    shared = shared_columns(resolved, chosen)
    moved = polish is not None and polish.after != polish.before
    value = choice.value
    if polish is not None and moved:
        value = polish.after
    elif chosen.retained:
        value = scores[0].value
    return DesignSection(
        criterion=table.judged_by,
        n=scores[0].n,
        value=value,
        bound=None if moved else choice.bound,
        efficiency=None if moved else choice.efficiency,
        kappa=scores[0].kappa,
        observability=scores[0].observability,
        poses=planned_readings(chosen.measurement, chosen.scheduled),
        scaling=table.scaling,
        candidates=chosen.candidates,
        plans=scores,
        words=certificate_text(chosen, shared),
        directions=choice.directions - shared,
        columns=choice.columns - shared,
        gap=None if moved else choice.duality_gap,
        proven=choice.proven and not moved,
        compound=dict(table.compound),
        setups=chosen.order.setups,
        retained=chosen.retained,
        cost_min=plan_seconds(chosen.measurement, chosen.series) / 60.0,
        refused=dict(resolved.refusals),
        compared=list(chosen.compared),
        polished=chosen.polish,
        order=chosen.order,
        robust=chosen.robust,
        how_many=chosen.how_many,
        relaxed=chosen.relaxed,
        effects=_effects(chosen),
    )


def _effects(chosen: ChosenDesign) -> AllowedEffects | None:
    """The effects of the design, with what else to record."""
    allowed = chosen.effects
    if allowed is None:
        return None
    recording = effects.recording(chosen.criteria, chosen.measurement, chosen.series)
    return msgspec.structs.replace(allowed, recording=recording)


def shared_columns(resolved: ResolvedStudy, chosen: ChosenDesign) -> int:
    """Columns that stand for the common errors of runs, not for parameters."""
    parameters = int(resolved.measurement.free.sum())
    return max(chosen.choice.columns - parameters, 0)


def planned_readings(
    measurement: Measurement, series: Sequence[Series]
) -> list[PlannedReading]:
    """The readings as poses to command, in working order, with their nominal values."""
    planned = []
    for s in series:
        instrument = measurement.setups[s.setup].instrument
        channels = instrument.channels
        expected = measurement.expected_readings(s)
        y = expected.reshape(len(s), len(channels))
        commands = s.reading_commands()
        joints = s.q[s.index[:, 0]]
        number: Counter[str] = Counter()
        for k, run in enumerate(s.run):
            number[run] += 1
            sent = displayed_joints(measurement.machine, joints[k])
            read = displayed_values(channels, y[k])
            reading = PlannedReading(
                setup=s.setup,
                run=str(run),
                order=number[run],
                command=displayed_command(measurement.machine, commands[k]),
                # what is recorded of a constraint are the joints at which it holds
                reading=read if instrument.implied is None else sent,
                joints=sent,
            )
            planned.append(reading)
    return planned


# -- how good the plan is known to be --------------------------------------------------


def certificate_text(chosen: ChosenDesign, shared: int = 0) -> str:
    """The certificate, its scope, and what polishing added.

    `shared` columns stand for the common errors of runs and are not counted.
    """
    kind = "runs" if chosen.criteria.table.whole_runs else "readings"
    what = f"{len(chosen.choice.indices)} of {chosen.candidates} {kind}"
    text = _certificate(chosen, what)
    text += _directions(chosen, shared)
    text += _shortfall(chosen)
    if chosen.relaxed is not None:
        text += ": the largest of the relaxation's weights"
    if chosen.retained:
        text += f", added to {chosen.retained} retained readings"
    polish = chosen.polish
    if polish is None:
        return f"{text}."
    return f"{text}. Then, off the grid, {polish.words}."


def _certificate(chosen: ChosenDesign, what: str) -> str:
    choice = chosen.choice
    if chosen.robust is not None:
        return _robust_certificate(chosen.robust, what)
    if choice.proven:
        return (
            f"Proven optimal: no other choice of {what} is better by {choice.criterion}"
        )
    if choice.efficiency is None:
        return (
            f"The best choice of {what} that the search found; no bound is known for"
            f" {choice.criterion} under these rules"
        )
    share = guaranteed_percent(choice.efficiency)
    text = f"Certified to {share:.1f} % of the best possible choice of {what}"
    if chosen.bound_ignores_setups:
        text += (
            " (the bound allows any number of set-ups: the choice is better than this"
            " figure)"
        )
    elif choice.duality_gap is not None and choice.duality_gap > SLACK:
        text += (
            f" (the bound itself may be {100 * choice.duality_gap:.0f} % too high: the choice"
            " is better than this figure)"
        )
    return text


def _directions(chosen: ChosenDesign, shared: int) -> str:
    """The scope, where the candidates do not see all parameters."""
    visible = chosen.choice.directions - shared
    columns = chosen.choice.columns - shared
    if visible >= columns:
        return ""
    text = (
        f", over the {visible} of {columns} directions that the candidates see (the"
        " identifiable subspace)"
    )
    if chosen.choice.weak:
        text += (
            f"; {chosen.choice.weak} of the directions left out are seen, but at least a"
            " million times worse than the best one: they count as not seen"
        )
    return text


def _shortfall(chosen: ChosenDesign) -> str:
    """A remark where the rules do not allow as many readings as the study asks for."""
    table, count = chosen.criteria.table, len(chosen.choice.indices)
    wanted = table.size
    if wanted is None or count >= wanted or table.budget_min is not None:
        return ""
    return f"; the study asks for {wanted}, but the rules leave no room for more"


def _robust_certificate(robust: RobustSummary, what: str) -> str:
    risk = {
        "mean": "on average",
        "cvar": f"over the worst {guaranteed_percent(robust.level):.1f} %",
        "worst": "for the worst one",
    }
    share = guaranteed_percent(robust.efficiency)
    gain = 100.0 * (np.exp(robust.value - robust.nominal) - 1.0)
    return (
        f"Chosen for {robust.scenarios} machines drawn from the tolerances,"
        f" {risk[robust.risk]}: certified to {share:.1f} % of the best possible choice of"
        f" {what} for them, and {gain:.1f} % better there than the plan for the nominal"
        " machine"
    )
