"""A case with all of its lengths times a factor.

No answer may depend on the unit of length: the same machine a thousand times as large,
read with a thousand times the noise, has the same columns of effects in units of the
noise (tests/benchmarks/test_random_machines.py). Times, turns, loads and temperatures
stay.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.random_machines import cases
from benchmarks.random_machines.cases import Case
from oed import build_study, identify, read_readings
from oed.effect_model import Effect
from oed.gap import GapProblem, assemble
from pkm_studies.resolve import GapRequest

FACTOR = 1000.0
#: units of length at the end of a field's name
LENGTHS = ("um", "mm", "m", "mm_min")
#: expected sizes of effects, um
SIZES = {
    "backlash": 10.0,
    "bar_length": 10.0,
    "drum_runout": 50.0,
    "encoder_subdivision": 0.1,
    "frame_bending": 20.0,
    "friction": 4.0,
    "gravity": 20.0,
    "guideway": 10.0,
    "joint_clearance": 10.0,
    "joint_runout": 4.0,
    "mount_drift": 5.0,
    "pitch_accumulation": 10.0,
    "pulley_radius": 1000.0,
    "screw_cyclic": 3.0,
    "step": 20.0,
    "target_offset": 100.0,
}
#: lead of the screws, period of the scales and circumference of the drums, m
LEAD, PERIOD, DRUM = 5e-3, 20e-6, 0.15
#: a file of effects with these
DRIVES = '''"""Cyclic errors with the lead and the period of this machine."""

import dataclasses

from pkm_models.effects import drum_runout, encoder_subdivision, screw_cyclic

lead = dataclasses.replace(screw_cyclic.effect, constants={{"pitch": ({lead},)}})
period = dataclasses.replace(
    encoder_subdivision.effect, constants={{"period": ({period},)}}
)
drum = dataclasses.replace(drum_runout.effect, constants={{"circumference": ({drum},)}})
'''


def prepared(case: Case, factor: float) -> tuple[GapProblem, Sequence[Effect]]:
    """The residuals of a case and the effects that its study tries.

    factor   on the sizes, the lead, the period and the drum that the study states
    """
    with tempfile.TemporaryDirectory() as folder:
        path = cases.write(case, Path(folder))
        study = build_study(
            _with_sizes(case.study, Path(folder), factor), folder, allow_code=True
        )
        state = identify(read_readings(study, path)).state
        request = GapRequest.of_study(study, state.resolved.machine)
    readings, estimate = state.readings, state.estimate
    assert readings.covariates is not None
    residuals = assemble(
        state.measurement,
        readings.series,
        readings.covariates,
        estimate.theta,
        readings.y,
        gravity=request.gravity,
    )
    return residuals, request.effects


# -- lengths times a factor ------------------------------------------------------------


def _with_sizes(
    study: Mapping[str, Any], folder: Path, factor: float
) -> dict[str, Any]:
    """The study with stated sizes of effects, and a lead and period of its own."""
    drives = folder / "drives.py"
    text = DRIVES.format(lead=LEAD * factor, period=PERIOD * factor, drum=DRUM * factor)
    drives.write_text(text, encoding="utf-8")
    effects = {f"{name}_um": factor * size for name, size in SIZES.items()}
    gap = {"effects": ["all", "drives.py:lead", "drives.py:period", "drives.py:drum"]}
    return {**study, "effects": effects, "gap": gap}


def scaled(case: Case, factor: float = FACTOR) -> Case:
    """The case with its lengths times a factor."""
    readings = case.readings.copy()
    for column in readings.columns:
        if _is_length(str(column)):
            readings[column] = factor * readings[column]
    study = _scaled(case.study, factor)
    return dataclasses.replace(case, study=study, readings=readings)


def _is_length(name: str) -> bool:
    return any(name.endswith(f"_{unit}") for unit in LENGTHS)


def _scaled(table: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """A table of a study with its lengths times a factor."""
    result: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            result[name] = _scaled(value, factor)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            result[name] = [_scaled(item, factor) for item in value]
        else:
            result[name] = _times(value, factor) if _is_length(name) else value
    return result


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, list):
        return [_times(item, factor) for item in value]
    return factor * value
