"""No answer of a diagnosis depends on the unit of length.

The same machine a thousand times as large, read with a thousand times the noise, has the
same columns of effects in units of the noise. Times, turns, loads and temperatures stay.
"""

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.random_machines import cases, machines, sessions
from benchmarks.random_machines.cases import Case
from oed import build_study, identify, read_readings
from oed.effect_model import Effect
from oed.gap import GapProblem, assemble
from oed.gap.forms import library
from oed.mechanism import AssemblyError
from pkm_studies.resolve import GapRequest

#: the nightly run has one family of each kind
BY_NIGHT = ("hexapod_ups", "cables_planar", "tripod_rps")
FAMILIES = ["delta", *(pytest.param(n, marks=pytest.mark.slow) for n in BY_NIGHT)]
FACTOR = 1000.0
LENGTHS = ("um", "mm", "m", "mm_min")  #: units of length at the end of a field's name
#: expected sizes of effects, um
SIZES = {
    "backlash": 10.0, "bar_length": 10.0, "drum_runout": 50.0,
    "encoder_subdivision": 0.1, "frame_bending": 20.0, "friction": 4.0, "gravity": 20.0,
    "guideway": 10.0, "joint_clearance": 10.0, "joint_runout": 4.0, "mount_drift": 5.0,
    "pitch_accumulation": 10.0, "pulley_radius": 1000.0, "screw_cyclic": 3.0,
    "step": 20.0, "target_offset": 100.0,
}  # fmt: skip
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
    """The residuals of a case and its effects, of sizes and periods times a factor."""
    with tempfile.TemporaryDirectory() as folder:
        path = cases.write(case, Path(folder))
        study = build_study(
            _with_sizes(case.study, Path(folder), factor), folder, allow_code=True
        )
        state = identify(read_readings(study, path)).state
        request = GapRequest.from_study(study, state.resolved.machine)
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


# -- machines that are read in every way -----------------------------------------------
#: six paths both ways in two hours, with all that can be written down
PLAN = sessions.Plan(
    runs=6,
    readings=15,
    both=True,
    columns=frozenset(("time", "direction", "feed", "payload")),
    feeds=(2e3, 5e3),
    payloads=(0.0, 50.0),
    pause=400.0,
    step=10.0,
    regular=True,
)


def draw_fully_read(model: str, kind: str, seed: int) -> Case:
    """A machine of a family, read by an instrument of a kind."""
    rng = np.random.default_rng(seed)
    own = cases.machine_of({"model": model})
    while True:
        drawn = machines.draw(model, own, rng)
        feeds = [drawn.size * feed for feed in PLAN.feeds]
        plan = dataclasses.replace(PLAN, feeds=feeds)
        try:
            return cases.case_of(
                drawn, sessions.draw_law("white", rng), rng, [kind], plan
            )
        except AssemblyError:
            continue


@pytest.mark.parametrize("model", FAMILIES)
def test_columns_of_effects_have_no_unit_of_length(model):
    """At the fitted parameters, which are a little apart: a fit ends early."""
    kind = "planar_position" if model == "cables_planar" else "ball_bar"
    drawn = draw_fully_read(model, kind, 6)
    larger = scaled(drawn)
    usual, effects = prepared(drawn, 1.0)
    other, effects_there = prepared(larger, FACTOR)
    apart = np.abs(other.slopes - usual.slopes).max()
    assert apart < 1e-4 * np.abs(usual.slopes).max()
    for effect, effect_there in zip(effects, effects_there, strict=True):
        here = library.build(usual, [effect])
        there = library.build(other, [effect_there])
        assert there.columns.shape == here.columns.shape, effect.name
        columns = here.columns.all()
        size = np.abs(columns).max(axis=0, initial=1e-6)
        change = np.abs(there.columns.all() - columns) / size
        assert change.max(initial=0.0) < 1e-2, effect.name
