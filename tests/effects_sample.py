"""Sessions of readings with all covariates on every machine, for the tests of effects."""

import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pandas as pd
from kernel.cases import CASES

from oed.gap.data.state import states
from oed.measurement.measurement import Measurement
from oed.model.effect import Column, Effect, State
from pkm_studies import catalogue
from pkm_studies.base import Place
from pkm_studies.user_code import Origin

NAMES = (
    "leg_thermal",
    "frame_thermal",
    "gravity",
    "frame_bending",
    "backlash",
    "friction",
    "servo_lag",
    "encoder_scale",
    "cable_stretch",
    "cable_sag",
    "post_compliance",
    "pulley_radius",
    "drum_runout",
    "gear_eccentricity",
    "pitch_accumulation",
    "screw_cyclic",
    "encoder_subdivision",
    "guideway",
    "joint_runout",
    "joint_clearance",
    "bar_length",
    "bar_thermal",
    "mount_drift",
    "step",
)
#: errors of references and instruments, each by an instrument that has it
REFERENCES = {
    "ruler_bow": "rm5",
    "square_error": "rm4",
    "plate_certificate": "ball_plate",
    "probe_lobing": "height_probe",
    "probe_abbe": "height_probe",
    "air_refraction": "rm5",
    "target_offset": "pose_tracker",
}
CARRIAGES = {
    "hexaglide",
    "linear_delta",
    "planar_2dof",
    "prs_spindle",
    "prs_spindle_struts",
}
CABLES = {"cable_robot"}
HERE = Place("x.study.toml", "gap.effects")
ROUND, FEED, HOURS = 24, 0.03, 7200.0
COVARIATES = ("time", "direction", "feed", "payload")


@functools.cache
def effect_of(name: str) -> Effect:
    found = catalogue.effect(name, Origin(), HERE)
    assert isinstance(found, Effect)
    return found


@functools.cache
def session(machine: str, known: tuple[str, ...] = COVARIATES) -> SimpleNamespace:
    """Two set-ups, each a loop through the workspace there and back, within two hours."""
    case = CASES[machine]
    lower, upper = (
        np.array([getattr(c, side) for c in case.machine.command])
        for side in ("lower", "upper")
    )
    at = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    loop = np.column_stack(
        [
            f((k // 2 + 1) * at)
            for k, f in zip(range(len(lower)), [np.cos, np.sin] * 3, strict=False)
        ]
    )
    there = 0.5 * (lower + upper) + 0.15 * (upper - lower) * loop
    command, runs = (
        np.vstack([there, there[::-1]]),
        ["there"] * ROUND + ["back"] * ROUND,
    )
    measurement = Measurement(
        case.machine, [case.setups["ball_bar"], case.setups["camera"]]
    )
    series = tuple(measurement.series(s, command, runs) for s in ("ball_bar", "camera"))
    rows = 4 * ROUND
    covariates = {
        "order": np.tile(np.arange(1, ROUND + 1), 4),
        "time": np.linspace(0.0, HOURS, rows),
        "direction": np.tile(np.repeat([1.0, -1.0], ROUND), 2),
        "feed": np.full(rows, FEED),
        "payload": np.repeat([0.0, 150.0], rows // 2),
        "temp_leg": np.linspace(20.0, 22.0, rows),
    }
    if machine in CABLES:
        covariates |= {
            f"tension_{k}": 40.0 + 20.0 * np.sin(0.3 * k * np.arange(rows))
            for k in range(1, 1 + len(case.machine.joints))
        }
    frame = pd.DataFrame(
        {
            n: v
            for n, v in covariates.items()
            if n == "order" or n in known or (known and n.startswith("tension_"))
        }
    )
    return SimpleNamespace(
        case=case,
        measurement=measurement,
        series=series,
        states=states(measurement, series, frame, measurement.nominal),
        responses=[measurement.of(s).response(s, measurement.nominal) for s in series],
    )


def columns(name: str, state: State, **constants: float) -> dict[str, Column]:
    """An effect's columns by name, at given constants or the first of its grid."""
    made = list(
        effect_of(name).columns(
            state, **(effect_of(name).constant_grid()[0] | constants)
        )
    )
    assert len({c.name for c in made}) == len(made)
    return {c.name: c for c in made}


def small(state: State, m: int, **changes: object) -> State:
    """The state's first m poses."""
    whole = {f.name: getattr(state, f.name) for f in dataclasses.fields(state)}
    cut = {
        n: v[:m] if isinstance(v, np.ndarray) and len(v) == len(state) else v
        for n, v in whole.items()
    }
    cut["temperature"] = {}
    return State(**(cut | changes))
