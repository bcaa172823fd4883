"""Results in memory and in folders, for tests of exports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from oed.base import units
from oed.model.machine import Machine
from oed.result import (
    SCHEMA,
    DesignSection,
    EstimateSection,
    MachineInfo,
    ParameterEstimate,
    PlannedReading,
    StudyResult,
)

SETUPS = {
    "linear_delta": 'instrument = "height_probe"',
    "delta": 'instrument = "height_probe"',
    "hexapod": 'instrument = "pose_tracker"',
    "micro_cmm": 'instrument = "pose_tracker"',
    "a3_head": 'instrument = "ball_bar"',
    "rotary_delta": 'instrument = "pose_tracker_position"',
    "hexapod_pus": 'instrument = "pose_tracker"',
    "hexapod_rus": 'instrument = "pose_tracker"',
    "pentapod": 'instrument = "pose_tracker_position"',
    "orthoglide": 'instrument = "pose_tracker_position"',
    "five_bar": 'instrument = "planar_position"',
    "cables_planar": 'instrument = "planar_position"',
}


def study_text(machine: str) -> str:
    return (
        f'schema = 1\nname = "sample"\n[machine]\nmodel = "{machine}"\n'
        f'[[setup]]\nname = "s"\n{SETUPS[machine]}\n'
    )


def result(
    machine: Machine, values: np.ndarray, *, chi2: float = 20.0, **sections: Any
) -> StudyResult:
    """A result with these parameters (np,), SI, of 20 degrees of freedom."""
    parameters = {}
    for p, value in zip(machine.parameters, values, strict=True):
        unit = units.display(p.unit)
        parameters[p.name] = ParameterEstimate(
            value=units.number(float(value), unit),
            sd=0.01,
            unit=unit,
            nominal=units.number(p.nominal, unit),
            prior_sd=units.number(p.tolerance, unit),
            identified="seen",
        )
    estimate = EstimateSection(
        parameters=parameters,
        rms_before={},
        rms_after={},
        units={},
        channels=[],
        readings=30,
        dof=20.0,
        chi2=chi2,
        iterations=[],
        warnings=[],
        residuals=[],
        residuals_before=[],
    )
    return StudyResult(
        schema=SCHEMA,
        version="0",
        study="sample",
        seed=1,
        seconds=0.0,
        machine=MachineInfo(machine.name, "", "", [], []),
        study_text=study_text(machine.name),
        estimate=estimate,
        **sections,
    )


def design(poses: list[dict[str, float]]) -> DesignSection:
    """A design of these commands; what no export reads is empty."""
    readings = [
        PlannedReading(setup="s", run="1", order=k, command=pose, reading={})
        for k, pose in enumerate(poses, start=1)
    ]
    fields: dict[str, Any] = {
        f.name: _empty(f.type)
        for f in msgspec.structs.fields(DesignSection)
        if f.required
    }
    return DesignSection(**{**fields, "poses": readings})


def _empty(kind: Any) -> Any:
    if kind in (int, float, str, bool):
        return kind()
    origin = getattr(kind, "__origin__", None)
    return origin() if origin in (list, dict) else None


def save(folder: Path, content: StudyResult) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_bytes(msgspec.json.encode(content))
    return folder


def with_text(content: StudyResult, text: str) -> StudyResult:
    """The result with another study."""
    return msgspec.structs.replace(content, study_text=text)
