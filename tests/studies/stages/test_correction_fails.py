"""A correction for effects that does not converge, after a diagnosis and by name."""

from types import SimpleNamespace
from unittest import mock

import pytest

from oed.estimation import IdentificationError
from pkm_studies.stages.correct import corrected


@pytest.fixture
def state(monkeypatch: pytest.MonkeyPatch) -> mock.MagicMock:
    """A fit whose correction for a step fails; its warnings are returned."""
    error = IdentificationError("the fit did not converge")
    effects = [SimpleNamespace(name="step")]
    monkeypatch.setattr(corrected, "_effects", lambda *given: effects)
    readings = mock.MagicMock()
    readings.return_value.estimate.side_effect = error
    monkeypatch.setattr(corrected, "readings_with_covariates", readings)
    state = mock.MagicMock(with_effects=())
    state.add_warnings = lambda *warnings: warnings
    return state


def test_a_diagnosis_stands_where_its_correction_fails(state):
    (warning,) = corrected.correct_for_effects(state)
    assert warning.startswith("nothing is corrected for step")
    assert "did not converge" in warning


def test_effects_that_were_named_are_refused(state):
    state.with_effects = ("step",)
    with pytest.raises(IdentificationError):
        corrected.correct_for_effects(state)
