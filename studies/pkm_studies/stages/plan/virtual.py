"""Virtual machines carried through the plan, entered into the records of its stages."""

from __future__ import annotations

import msgspec
import numpy as np

from oed import result
from oed.base.arrays import Array
from oed.design.stages.sequence.stage_plan import StagePlan
from oed.design.stages.virtual_machines.propagation import StageRealisation, propagate
from pkm_studies.base.progress import Progress
from pkm_studies.stages.plan.task import PlanTask


def add_realisations(
    task: PlanTask,
    plan: StagePlan,
    records: list[result.StageRecord],
    rng: np.random.Generator,
    progress: Progress,
    start: Array | None,
) -> list[result.StageRecord]:
    """The records of a plan's stages, with the accuracy that virtual machines reach.

    start  (n, n) covariance from which machines are drawn, in units of the tolerances;
           None: the tolerances
    """
    if not task.table.virtual_machines:
        return records
    progress.stage("virtual machines through the plan")
    where = task.request.prediction
    realisation = propagate(
        plan.stages,
        where.command,
        task.table.virtual_machines,
        rng,
        reference=where.table.reference,
        start=start,
        progress=progress.share,
    )
    return [
        _with_realisation(record, stage, realisation.names)
        for record, stage in zip(records, realisation.stages, strict=True)
    ]


def _with_realisation(
    record: result.StageRecord, stage: StageRealisation, names: tuple[str, ...]
) -> result.StageRecord:
    ratios = zip(names, stage.ratio, strict=True)
    return msgspec.structs.replace(
        record,
        realised={name: float(v) for name, v in ratios if np.isfinite(v)},
        realised_lost=stage.realised_loss * (record.chosen or 0),
        coverage=stage.coverage,
    )
