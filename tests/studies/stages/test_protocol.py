"""Repeat protocols: passes averaged into one reading, or each a reading."""

from pathlib import Path

import numpy as np
import pytest

from oed.identifiability import Assessment
from pkm_studies import study
from pkm_studies.base import InputError
from pkm_studies.resolve import ResolvedStudy, resolve
from pkm_studies.stages.design.select import single_stage_plan

STUDY = """
schema = 1
name = "passes"
[machine]
model = "a3_head"
[[setup]]
name = "cup"
instrument = "ball_bar"
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }
PROTOCOL
[[design.reference]]
name = "two circles"
setup = "cup"
z_mm = [1146.0, 1266.0]
psi_deg = { from = 0.0, to = 360.0, count = 15, endpoint = false }
theta = "hold"
runs_by = "z"
"""


def resolved(protocol: str) -> ResolvedStudy:
    return resolve(
        study.Study.parse(
            STUDY.replace("PROTOCOL", protocol), Path("passes.study.toml")
        )
    )


def test_the_mean_of_six_passes_has_less_noise_and_takes_six_times_as_long():
    once, six = resolved(""), resolved("repeats = 3\nboth_directions = true")
    assert six.setups["cup"].sigma[0] == pytest.approx(
        once.setups["cup"].sigma[0] / np.sqrt(6)
    )
    series = six.reference_plans[0].series
    assert len(series[0]) == 30
    seconds = [
        single_stage_plan(
            r, Assessment.of(r.measurement, r.reference_plans[0].series), {}
        ).cost
        * 60
        for r in (once, six)
    ]
    mounting = once.setups["cup"].instrument.cost.setup
    assert (seconds[1] - mounting) == pytest.approx(6 * (seconds[0] - mounting))


def test_separate_passes_hold_what_their_mean_holds():
    """180 readings have the same information as 30 means of six, in runs by pass."""
    separate = resolved("repeats = 3\nboth_directions = true\naverage = false")
    mean = resolved("repeats = 3\nboth_directions = true")
    verdicts = [
        Assessment.of(r.measurement, r.reference_plans[0].series, "tolerance")
        for r in (separate, mean)
    ]
    assert len(verdicts[0].series[0]) == 180
    assert verdicts[0].shrinkage == pytest.approx(verdicts[1].shrinkage, rel=1e-9)
    runs = list(dict.fromkeys(verdicts[0].series[0].run))
    assert runs[:2] == ["z=1146mm, forward 1", "z=1146mm, forward 2"]
    assert len(runs) == 12
    series = verdicts[0].series[0]
    forth, back = (
        series.reading_commands()[series.run == f"z=1266mm, {way} 2", 1]
        for way in ("forward", "backward")
    )
    assert (back == forth[::-1]).all()


def test_runs_that_carry_their_reference_are_not_repeated():
    text = (
        STUDY.replace("ball_bar", "calliper")
        .replace("teach =", "# teach =")
        .replace("PROTOCOL", "repeats = 2")
    )
    with pytest.raises(InputError, match="repeats"):
        resolve(study.Study.parse(text, Path("passes.study.toml")))
