"""`states` of [prediction]: read with their units, refused where nothing follows from them."""

from pathlib import Path

import bad_fit_sample
import bar_readings
import numpy as np
import pandas as pd
import pytest
import sample

from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.resolve import resolve
from pkm_studies.stages.fit.estimate import (
    displayed_states,
    extrapolated_states,
    recorded_states,
)
from pkm_studies.study import Study

WORKSPACE = """
[prediction]
z_mm = [1100, 1200]
psi_deg = [0, 90]
theta_deg = 20
states = {states}
"""
ALLOWED = '[identify]\neffects = "catalogue"\n'


def written(folder: Path, states: str, allowed: str = ALLOWED) -> Path:
    file = folder / "small.study.toml"
    text = sample.STUDY.replace("[report]", allowed + "\n[report]")
    file.write_text(text + WORKSPACE.format(states=states), encoding="utf-8")
    return file


def test_states_are_read_with_their_units(tmp_path):
    states = "{ payload_N = [0, 500], temp_leg1_C = 30, direction = [-1, 1] }"
    resolved = resolve(Study.load(written(tmp_path, states)), readings=[])
    values = resolved.prediction.states
    assert set(values) == {"payload", "temp_leg1", "direction"}
    np.testing.assert_allclose(values["payload"], [0.0, 500.0])
    np.testing.assert_allclose(values["temp_leg1"], [30.0])


@pytest.mark.parametrize(("states", "words"), [
    ("{ payload_mm = 1 }", "no covariate"),
    ("{ wind_N = 1 }", "no covariate"),
    ("{ time_s = 1 }", "as in the session"),
    ("{ payload_N = [] }", "no value"),
    ("{ direction = [0.5, 1] }", r"\+1 or -1"),
    ("{ payload_N = [0, 1e30] }", "so large"),
    ("{ feed_mm_min = -1 }", "at least 0"),
])  # fmt: skip
def test_what_is_no_state_is_refused(tmp_path, states, words):
    with pytest.raises(InputError, match=words):
        resolve(Study.load(written(tmp_path, states)), readings=[])


def test_states_beyond_the_readings_are_said_to_be():
    """Recorded: 0 and 100 N, 293 to 296 K; what lies inside is no extrapolation."""
    rows = pd.DataFrame(
        {"payload": [0.0, 100.0, np.nan], "temp_leg1": [20.0, 23.0, 22.0]}
    )
    used = {"payload": np.array([0.0, 500.0]), "temp_leg1": np.array([21.0])}
    (sentence,) = extrapolated_states(used, rows)
    assert "payload_N 0 and 500" in sentence
    assert "0 to 100" in sentence
    used = {"payload": np.array([0.0, 100.0])}
    assert not extrapolated_states(used, rows)


def test_states_need_effects(tmp_path):
    """Where the study keeps the geometry alone."""
    bare = '[identify]\neffects = "none"\n'
    with pytest.raises(InputError, match="only effects differ"):
        resolve(Study.load(written(tmp_path, "{ payload_N = 1 }", bare)), readings=[])


def test_a_state_that_no_reading_recorded_is_refused(tmp_path, capsys):
    study, readings = bad_fit_sample.write(tmp_path, bar_readings.a3_readings(0))
    text = study.read_text().replace(
        "[prediction]\n", "[prediction]\nstates = { temp_frame_C = [18, 26] }\n"
    )
    study.write_text(text.replace('effects = "none"', 'effects = ["gravity"]'))
    out = tmp_path / "out"
    arguments = ["identify", str(study), "--readings", str(readings)]
    assert main([*arguments, "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "temp_frame_C" in message
    assert "record it in the readings" in message


def test_recorded_states_are_the_default():
    """Two directions and payloads as they are, a leg cold and warm, no bar."""
    rows = pd.DataFrame(
        {
            "direction": [1.0, -1.0, 1.0, np.nan],
            "payload": [0.0, 50.0, 200.0, 0.0],
            "feed": [0.01, 0.02, 0.01, 0.02],
            "temp_leg1": [20.0, 21.0, 23.0, 22.0],
            "temp_leg2": [20.0, 20.0, 20.0, 20.0],
            "temp_bar": [20.0, 20.5, 21.0, 20.2],
        }
    )
    states = recorded_states(rows)
    assert set(states) == {"direction", "payload", "temp_leg1"}
    np.testing.assert_allclose(states["direction"], [-1.0, 1.0])
    np.testing.assert_allclose(states["payload"], [0.0, 50.0, 200.0])
    np.testing.assert_allclose(states["temp_leg1"], [20.0, 23.0])
    shown = displayed_states(states)
    assert shown["payload_N"] == [0.0, 50.0, 200.0]
    assert shown["temp_leg1_C"] == [20.0, 23.0]
    assert recorded_states(None) == {}
