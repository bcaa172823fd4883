"""Compares readings along runs of the compensated machine with their prediction.

The set-up is mounted anew, so that its unknowns have their tolerances again. With their
covariance and that of the estimate, C, readings have the covariance K = J C J^T + S
about the prediction, J at the compensated joints. The unknowns of the set-up are taken
out of what is shown: r - J_s C_s J_s^T K^-1 r.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from scipy import linalg, stats

from oed import units
from oed.base import Array
from oed.measurement import Measurement, Series
from oed.result import CorrectedSection, EstimateSection, RunCurve
from oed.text import format_p_value
from pkm_studies import result_folder
from pkm_studies.base import Location, Silent
from pkm_studies.compensation import result_study
from pkm_studies.results import load_result, refuse_bad_fit
from pkm_studies.stages import compensated_series, measured_curves, start
from pkm_studies.user_code import Consent

#: probability below which readings contradict their prediction
SURPRISE = 1e-3


@dataclasses.dataclass(frozen=True)
class RunCheck:
    """Readings of the compensated machine against their prediction.

    curves       along circles and lines
    readings     number of values
    p_high       probability of a larger chi2
    """

    curves: list[RunCurve]
    readings: int
    p_high: float

    @property
    def passed(self) -> bool:
        """Whether the prediction stands."""
        return self.p_high >= SURPRISE


def check_folder(
    folder: Path,
    readings: Path,
    study_file: Path | None = None,
    consent: Consent = Consent.RECORDED,
) -> RunCheck:
    """Compare the readings with the result of a folder, and write the runs into it.

    Raises InputError where the result holds no estimate, where its commands are unknown
    or out of reach, and as readings are read; BadFitError where the fit promises
    nothing.
    """
    result = load_result(folder)
    location = Location(str(folder / "result.json"))
    section = result.final_estimate
    if section is None or not section.covariance:
        raise location.error(
            "this result has no estimate", "identify the machine first"
        )
    refuse_bad_fit(result)
    study = result_study(result, folder, study_file, consent)
    state = start(study, None, Silent(), [readings])
    data = state.resolved.dataset
    if data is None:
        raise location.error(
            f"{readings} has no readings", "give readings of the study"
        )
    measurement = state.resolved.measurement_with(set(data.setups))
    check = _compare(measurement, data.series, data.y, section)
    if check is None:
        raise location.error(
            "the compensated machine's joints are not known at these readings",
            "record commands within reach, not joints",
        )
    result = msgspec.structs.replace(result, after_compensation=check.curves)
    result_folder.rewrite(folder, result)
    return check


def _compare(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    section: EstimateSection | CorrectedSection,
) -> RunCheck | None:
    """The comparison; None where the compensated joints are not known."""
    theta, covariance = _knowledge(measurement, section)
    compensated = compensated_series(measurement, series, theta)
    if compensated is None:
        return None
    residual = y - measurement.readings(compensated, theta)
    jacobian = measurement.jacobian(compensated, theta)
    noise = np.diag(_noise_sigma(measurement, series, section) ** 2)
    total = jacobian @ covariance @ jacobian.T + noise
    count = len(measurement.machine.parameters)
    of_setup, of_parameters = jacobian[:, count:], covariance[count:, count:]
    root = linalg.cho_factor(total)
    weighed = linalg.cho_solve(root, residual)
    gain = of_setup @ of_parameters @ of_setup.T
    remaining = residual - gain @ weighed
    keep = np.eye(len(y)) - gain @ linalg.cho_solve(root, np.eye(len(y)))
    sd = np.sqrt(np.einsum("ij,jk,ik->i", keep, total, keep))
    return RunCheck(
        curves=measured_curves(measurement, series, y, y - remaining, sd),
        readings=len(y),
        p_high=float(stats.chi2.sf(residual @ weighed, len(y))),
    )


def _knowledge(
    measurement: Measurement, section: EstimateSection | CorrectedSection
) -> tuple[Array, Array]:
    """Parameters (n,), SI, and their covariance (n, n); set-ups are mounted anew."""
    theta = measurement.nominal.copy()
    covariance = np.array(measurement.prior_covariance)
    names = list(section.parameters)
    of_machine = {p.name for p in measurement.machine.parameters}
    stored = np.array(section.covariance)
    columns = [(k, n) for k, n in enumerate(measurement.names) if n in names]
    columns = [(k, n) for k, n in columns if n in of_machine]
    places = [k for k, _ in columns]
    rows = [names.index(n) for _, n in columns]
    factor = np.array([units.factor(section.parameters[n].unit) for _, n in columns])
    theta[places] = factor * [section.parameters[n].value for _, n in columns]
    covariance[places] = covariance[:, places] = 0.0
    covariance[np.ix_(places, places)] = stored[np.ix_(rows, rows)] * np.outer(
        factor, factor
    )
    return theta, covariance


def _noise_sigma(
    measurement: Measurement,
    series: Sequence[Series],
    section: EstimateSection | CorrectedSection,
) -> Array:
    """Stated noise (N,), SI, enlarged where the fit left more than it."""
    scale = 1.0
    if section.dof > 0.0:
        scale = max(1.0, float(np.sqrt(section.chi2 / section.dof)))
    return scale * measurement.sigma(series)


def check_sentences(check: RunCheck) -> Iterator[str]:
    """The comparison in words."""
    largest, unit = 0.0, ""
    inside = count = 0
    for curve in check.curves:
        error = np.abs(np.subtract(curve.measured, curve.predicted))
        inside += int((error <= curve.half_widths).sum())
        count += len(error)
        if error.max() > largest:
            largest, unit = float(error.max()), curve.unit
    if count:
        yield (
            f"{inside} of {count} readings along {len(check.curves)} runs lie inside their"
            f" 95 % interval; the largest difference from the prediction is {largest:.3g}"
            f" {unit}."
        )
    verdict = "agree with" if check.passed else "contradict"
    yield (
        f"The {check.readings} readings after compensation {verdict} their prediction"
        f" (p {format_p_value(check.p_high)})."
    )
    if not check.passed:
        yield "Effects beside the parameters are at work: run `oed diagnose`."
