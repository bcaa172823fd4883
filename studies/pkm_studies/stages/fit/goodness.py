"""Checks recorded readings, and reports it: the section `goodness` of the result."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from oed import checks, text
from oed.checks import CheckedSession, Explanation, FarReading, Goodness, misfits
from oed.dataset import Dataset
from oed.estimation import RunPrediction
from oed.result import GoodnessSection, MistakeRecord, OutlierRecord
from pkm_studies.resolve import ResolvedStudy
from pkm_studies.stages.run_state import Measured

#: runs that a sentence names, at most
NAMED = 3


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
        return state.add_sections(goodness=fit_figures(fitted))
    judged = checked.with_goodness(fitted, noise_is_a_guess=state.noise_is_a_guess)
    judged = _assumption_text(judged, is_assumed=state.study.noise.assumed)
    before = {finding.sentence for finding in checked.findings}
    others = [warning for warning in state.warnings if warning not in before]
    sentences = [finding.sentence for finding in judged.findings]
    state = state.replace(checked=judged, warnings=(*sentences, *others))
    return state.add_sections(goodness=goodness_section(judged))


def goodness_section(checked: CheckedSession) -> GoodnessSection:
    """The check as a section of the result."""
    fitted, outliers = checked.goodness, checked.outliers
    mistakes = [
        MistakeRecord(what=one.what, evidence=_evidence(one))
        for one in checked.explanations
    ]
    return replace(
        fit_figures(fitted),
        bad_fit=checked.bad_fit,
        outliers=_records(checked, () if outliers is None else outliers.gross),
        doubtful=_records(checked, () if outliers is None else outliers.doubtful),
        unlocated=_unlocated_rows(checked),
        mistakes=mistakes,
        findings=[finding.sentence for finding in checked.findings],
    )


def fit_figures(fitted: Goodness | None) -> GoodnessSection:
    """The section with the figures of a fit alone; without a fit, none are known."""
    if fitted is None:
        return GoodnessSection(None, None, None, None)
    return GoodnessSection(**dataclasses.asdict(fitted))


def _evidence(explanation: Explanation) -> str:
    probability = text.percent(explanation.probability)
    compared = misfits(explanation.before, explanation.after)
    return f"probability {probability}; {compared}"


def _unlocated_rows(checked: CheckedSession) -> list[int]:
    """Rows of the file one of which is wrong; none where the readings tell which."""
    unlocated = () if checked.outliers is None else checked.outliers.unlocated
    row = checked.session.values["row"].to_numpy()
    first = np.searchsorted(checked.session.reading_of_value, sorted(unlocated))
    return [int(k) for k in row[first]]


def _records(checked: CheckedSession, far: Sequence[FarReading]) -> list[OutlierRecord]:
    """Readings by their place in the file."""
    records = []
    for one in far:
        row = checked.session.values.iloc[one.value]
        records.append(
            OutlierRecord(
                setup=str(row["setup"]),
                run=str(row["run"]),
                order=int(row["order"]),
                row=int(row["row"]),
                file=checked.session.file_of(one.value),
                pull=one.pull,
            )
        )
    return records


# -- each run against all others -------------------------------------------------------


def add_left_out(
    section: GoodnessSection, prediction: RunPrediction | None
) -> GoodnessSection:
    """The section with the runs; as it is where there is one run alone."""
    if prediction is None:
        return section
    return msgspec.structs.replace(
        section,
        left_out=list(prediction.runs),
        left_out_score=prediction.log_score,
        left_out_sd=prediction.log_score_sd,
    )


def surprises(prediction: RunPrediction | None) -> list[str]:
    """Runs that all others contradict, as one sentence; none where there are none."""
    far = () if prediction is None else prediction.surprising
    if not far:
        return []
    phrases = [
        f"run {one.run} of {one.setup} by {text.rounded(one.ratio)} times what is predicted (p"
        f" {text.format_p_value(one.p_high)})"
        for one in far[:NAMED]
    ]
    more = f", and {len(far) - NAMED} more runs" if len(far) > NAMED else ""
    return [f"all other runs contradict {', '.join(phrases)}{more}"]
