"""Checks recorded readings, and reports it: the section `goodness` of the result."""

import dataclasses

import numpy as np

from oed import checks
from oed.checks import CheckedSession, Goodness
from oed.dataset import Dataset
from pkm_studies.resolve import ResolvedStudy
from pkm_studies.stages.run_state import Measured


def check_dataset(
    resolved: ResolvedStudy, data: Dataset, rng: np.random.Generator
) -> CheckedSession:
    """What a check of recorded readings says. Raises AssemblyError."""
    session = checks.session_readings(
        resolved.measurement_with(data.setups),
        data.series,
        data.y,
        data.covariates,
        data.columns,
    )
    measurement = resolved.measurement_with(resolved.setups)
    guess = resolved.noise_is_a_guess(session.measurement, len(session.y))
    checked = checks.check_session(
        session,
        measurement,
        rng,
        noise_is_a_guess=guess,
        noise_is_estimated=resolved.study.noise.estimate is not False,
    )
    return _assumption_text(checked, is_assumed=resolved.study.noise.assumed)


def _assumption_text(checked: CheckedSession, *, is_assumed: bool) -> CheckedSession:
    """The check without what an assumed noise cannot say."""
    if not is_assumed:
        return checked
    # smaller residuals than an assumption say nothing of the readings
    findings = tuple(f for f in checked.findings if f.kind != "too_small")
    return dataclasses.replace(checked, findings=findings)


def add_delivered(state: Measured, fitted: Goodness) -> Measured:
    """The state whose check has the figures of the parameters that are delivered.

    The check looked at a fit of its own, by the stated noise.
    """
    checked = state.checked
    if checked is None:
        return state.add_sections(goodness=fitted.section)
    judged = checked.with_goodness(fitted, noise_is_a_guess=state.noise_is_a_guess)
    judged = _assumption_text(judged, is_assumed=state.study.noise.assumed)
    before = {finding.sentence for finding in checked.findings}
    others = [warning for warning in state.warnings if warning not in before]
    sentences = [finding.sentence for finding in judged.findings]
    state = state.replace(checked=judged, warnings=(*sentences, *others))
    return state.add_sections(goodness=judged.section)
