"""A notebook's diagnosis is the command's, and what a step refuses it explains."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

import oed
from oed.result import StudyResult
from pkm_studies import stages
from pkm_studies.notebook.views import EstimateView
from pkm_studies.results import load_result
from pkm_studies.stages.run_state import WithheldError

TABLES = {
    "name": "scaled",
    "machine": {"model": "planar_2dof"},
    "setup": [{"name": "rm4", "instrument": "rm4"}],
    "noise": {"dy_um": 3.0},
    "posterior": {"enabled": False},
    "prediction": {"y_mm": [-1000.0, 0.0, 1000.0], "z_mm": [300.0, 900.0]},
    "gap": {"effects": ["encoder_scale"]},
    "report": {"html": False, "pdf": False},
}
VIRTUAL = {
    "design": {
        "reference": [
            {
                "name": "lines",
                "setup": "rm4",
                "runs_by": "y",
                "y_mm": [-1500.0, 0.0, 1500.0],
                "z_mm": {"from": 0.0, "to": 1500.0, "count": 7},
            }
        ]
    },
    "readings": {"simulate": True, "draw": True},
    "gap": TABLES["gap"]
    | {
        "acting": [
            {"effect": "encoder_scale", "size": 1.5, "coefficients": {"leg 1": 1.0}}
        ]
    },
}


@pytest.fixture(scope="module")
def scaled(tmp_path_factory) -> tuple[oed.Study, Path]:
    """A study without readings, and readings of a machine with a wrong scale."""
    path = tmp_path_factory.mktemp("scaled") / "scaled.readings.csv"
    readings = oed.simulate(oed.build_study({**TABLES, **VIRTUAL}))
    readings.to_pandas().to_csv(path, index=False)
    return oed.build_study(TABLES), path


@pytest.fixture(scope="module")
def commanded(scaled, tmp_path_factory) -> StudyResult:
    """What `oed diagnose` writes."""
    study, path = scaled
    folder = tmp_path_factory.mktemp("out")
    stages.diagnose_study(study, [path], folder)
    return load_result(folder)


def of_file(section):
    """A section as result.json stores it."""
    return msgspec.json.decode(msgspec.json.encode(section))


@pytest.mark.slow
def test_a_notebook_has_the_diagnosis_of_the_command(scaled, commanded):
    study, path = scaled
    view = oed.diagnose(oed.identify(oed.read_readings(study, path)))
    assert commanded.gap.mixture is not None
    assert commanded.corrected is not None
    found = view.state.result
    for name in ("gap", "corrected", "estimate", "goodness", "identifiability"):
        told = of_file(getattr(commanded, name))
        assert of_file(getattr(found, name)) == told, name
    assert view.section.mixture == found.gap.mixture
    assert view.corrected == found.corrected
    assert set(commanded.warnings) == set(view.warnings)


def test_a_refused_step_says_why():
    estimate = oed.identify(oed.simulate(oed.build_study({**TABLES, **VIRTUAL})))
    # as a check leaves recorded readings that look mistaken
    state = estimate.state
    recorded = dataclasses.replace(state.readings, truth=None)
    bad = msgspec.structs.replace(state.goodness, bad_fit=True)
    checked = SimpleNamespace(mistaken=True, bad_fit=True, findings=())
    state = state.replace(readings=recorded, checked=checked)
    refused = EstimateView(state.add_sections(goodness=bad))
    with pytest.raises(WithheldError, match=r"prediction: .* rest on a bad fit"):
        oed.predict(refused)
    with pytest.raises(WithheldError, match=r"gap: .* a mistake in the readings"):
        oed.diagnose(refused)
    with pytest.raises(WithheldError, match=r"posterior: \[posterior\] enabled"):
        oed.sample(refused)
