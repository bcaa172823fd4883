"""Files of a plan: stages as CSV, commanded poses with their joints as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from oed import csv_text, result
from oed.measurement import Measurement, Series
from pkm_studies import describe
from pkm_studies.stages.design.section import planned_readings
from pkm_studies.stages.plan.section import PlanOutcome

HEADER = [
    "stage",
    "measurement",
    "setups",
    "readings",
    "identifies",
    "cost_min",
    "kappa",
]
#: columns of plans with times
TIMES = ["begin_min", "end_min", "price", "operator"]


def stages_csv(plan: result.PlanSection) -> str:
    """One row a stage, set-ups in working order; with times where the plan has them."""
    has_times = any(stage.begin_min is not None for stage in plan.stages)
    rows: list[list[object]] = [[*HEADER, *(TIMES if has_times else [])]]
    for number, stage in enumerate(plan.stages, start=1):
        times = _times(stage) if has_times else []
        rows.append([number, *_stage_cells(stage), *times])
    return csv_text.of_rows(rows)


def _stage_cells(stage: result.StageRecord) -> list[object]:
    return [
        stage.measurement,
        " ".join(stage.setups),
        stage.readings,
        stage.identifies,
        f"{stage.cost:.1f}",
        f"{stage.kappa:.4g}",
    ]


def _times(stage: result.StageRecord) -> list[object]:
    begin, end = stage.begin_min or 0.0, stage.end_min or 0.0
    return [f"{begin:.1f}", f"{end:.1f}", f"{stage.price:g}", stage.operator]


def poses_json(plan: PlanOutcome) -> str:
    """Commanded poses of each stage in working order, in user units.

    Each pose has the nominal joints and the nominal reading.
    """
    stages = []
    records = zip(plan.section.stages, plan.scheduled, strict=True)
    for number, (record, series) in enumerate(records, start=1):
        stages.append(
            {
                "stage": number,
                "measurement": record.measurement,
                "setups": record.setups,
                "begin_min": record.begin_min,
                "end_min": record.end_min,
                "poses": _poses(plan.measurement, series),
            }
        )
    content = msgspec.json.encode({"schema": 1, "stages": stages})
    return msgspec.json.format(content, indent=1).decode()


def _poses(measurement: Measurement, series: Sequence[Series]) -> list[dict[str, Any]]:
    poses = planned_readings(measurement, series)
    joints = [row for s in series for row in s.q[s.index[:, 0]]]
    return [
        msgspec.to_builtins(pose)
        | {"joints": describe.displayed_joints(measurement.machine, row)}
        for pose, row in zip(poses, joints, strict=True)
    ]
