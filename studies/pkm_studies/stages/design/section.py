"""Reports the design: the section `design`, with plan scores and poses to command."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from oed.identifiability.assessment import Assessment
from oed.measurement.measurement import Measurement, Series
from oed.result import DesignSection, PlannedReading
from pkm_studies.resolve.quantities import column
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.describe import displayed, displayed_command, displayed_joints
from pkm_studies.stages.design.certificate import certificate_text
from pkm_studies.stages.design.cost import plan_seconds
from pkm_studies.stages.design.plan_scores import plan_scores
from pkm_studies.stages.design.select import ChosenDesign


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
    )


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
        channels = measurement.setups[s.setup].instrument.channels
        nominal = measurement.readings([s], measurement.nominal)
        y = nominal.reshape(len(s), len(channels))
        commands = s.reading_commands()
        joints = s.q[s.index[:, 0]]
        number: Counter[str] = Counter()
        for k, run in enumerate(s.run):
            number[run] += 1
            values = zip(channels, y[k], strict=True)
            reading = PlannedReading(
                setup=s.setup,
                run=str(run),
                order=number[run],
                command=displayed_command(measurement.machine, commands[k]),
                reading={
                    column(c.name, c.unit): displayed(float(value), c.unit)
                    for c, value in values
                },
                joints=displayed_joints(measurement.machine, joints[k]),
            )
            planned.append(reading)
    return planned
