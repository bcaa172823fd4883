"""Files of a plan: stages as CSV, commanded poses with their joints for machines and
scripts.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import msgspec

from oed import result
from oed.measurement import Measurement, Series
from pkm_studies.resolve import quantities
from pkm_studies.stages import describe
from pkm_studies.stages.design import section as score
from pkm_studies.stages.plan.plan import Made

HEADER = [
    "stage",
    "measurement",
    "setups",
    "readings",
    "identifies",
    "cost_min",
    "kappa",
]
MORE = ["begin_min", "end_min", "price", "operator"]


def stages_csv(plan: result.PlanSection) -> str:
    """One row a stage, its set-ups in working order; times where the plan was searched
    for.
    """
    timed = any(s.begin_min is not None for s in plan.stages)
    rows: list[list[object]] = [[*HEADER, *(MORE if timed else [])]]
    for k, s in enumerate(plan.stages):
        row = [
            k + 1,
            s.measurement,
            " ".join(s.setups),
            s.readings,
            s.identifies,
            f"{s.cost:.1f}",
            f"{s.kappa:.4g}",
        ]
        begin, end = s.begin_min or 0.0, s.end_min or 0.0
        rows.append(
            [
                *row,
                *(
                    [f"{begin:.1f}", f"{end:.1f}", f"{s.price:g}", s.operator]
                    if timed
                    else []
                ),
            ]
        )
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def poses_json(made: Made) -> str:
    """Commanded poses of each stage in working order, with the nominal joints and
    reading, in user units.
    """
    stages = [
        {
            "stage": k + 1,
            "measurement": stage.measurement,
            "setups": stage.setups,
            "begin_min": stage.begin_min,
            "end_min": stage.end_min,
            "poses": _poses(made.measurement, series),
        }
        for k, (stage, series) in enumerate(
            zip(made.section.stages, made.scheduled, strict=True)
        )
    ]
    return msgspec.json.format(
        msgspec.json.encode({"schema": 1, "stages": stages}), indent=1
    ).decode()


def _poses(measurement: Measurement, series: Sequence[Series]) -> list[dict[str, Any]]:
    told = score.planned_readings(measurement, series)
    joints = [row for s in series for row in s.q[s.index[:, 0]]]
    names = [
        (quantities.column(j.name, j.unit), j.unit) for j in measurement.machine.joints
    ]
    return [
        msgspec.to_builtins(pose)
        | {
            "joints": {
                n: describe.shown(float(v), u)
                for (n, u), v in zip(names, row, strict=True)
            }
        }
        for pose, row in zip(told, joints, strict=True)
    ]
