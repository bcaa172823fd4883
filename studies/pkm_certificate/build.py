"""What the certificate of a result states: parameters, accuracy, conformity; in SI units."""

import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import special

from oed import safe_files, units
from oed.acceptance import Promise, measured_rms_within
from oed.base import Array
from oed.linear_algebra import covariance_root
from oed.model import Machine
from oed.result import CorrectedSection, EstimateSection, StudyResult
from oed.verdict import GEOMETRY_ALONE, accuracy_verdicts
from pkm_certificate import dcc, head
from pkm_certificate.statement import (
    Certificate,
    CertificateHead,
    CertifiedAccuracy,
    CertifiedParameter,
    Conformity,
)
from pkm_studies import quantities
from pkm_studies.acceptance import PromisedAccuracy, covariances
from pkm_studies.base import InputError, Location
from pkm_studies.compensation import result_study
from pkm_studies.results import estimated_section, load_result, refuse_bad_fit
from pkm_studies.study import Study
from pkm_studies.user_code import Consent

#: of a parameter's value, by how the readings see it
SOURCES = {
    "seen": "from the readings",
    "weak": "weakly seen by the readings",
    "prior": "from its tolerance: the readings do not see it",
}
NORMAL = "parameters are stated as normal; expanded uncertainties have a coverage factor of 2"
ACCURACY = (
    "predicted errors are those of the machine compensated with these parameters, over"
    " the workspace of the study"
)
OVER_ANSWERS = (
    "the parameters are those of the fit before its diagnosis; predicted errors are those"
    " of the machine compensated with the parameters over all hypotheses of the diagnosis, and"
    " hold the effects that these leave possible"
)
CHECKED = (
    "errors at the acceptance poses are taken as independent, each with the standard"
    " uncertainty of the plan, and nothing else is known of them"
)


def certificate(
    result: StudyResult,
    study: Study,
    head: CertificateHead,
    file: str,
    location: Location,
) -> Certificate:
    """All that the certificate of a result states.

    file      result.json
    location  of the tolerances

    Raises InputError for a result that certifies no machine, and for unknown names.
    """
    section = _estimate(result, file)
    promised = PromisedAccuracy.from_result(result, study, Path(file).parent, {}, {})
    machine = promised.machine
    names = [name for name, p in section.parameters.items() if _counts(name, p.sd)]
    indices = [machine.index(name) for name in names]
    covariance = covariances(machine, section)[0][np.ix_(indices, indices)]
    estimate = result.estimate
    return Certificate(
        head=head,
        study=result.study,
        version=result.version,
        machine=result.machine.name,
        about=result.machine.about,
        setups=[f"{s.name}: {s.instrument}" for s in result.setups],
        parameters=[_parameter(machine, section, name) for name in names],
        covariance=covariance.tolist(),
        readings=0 if estimate is None else estimate.readings,
        poses=promised.promise.workspace or len(promised.command),
        reference=promised.reference,
        predicted=list(_predicted(result, promised)),
        verified_poses=0 if result.acceptance is None else len(result.acceptance.poses),
        verified=list(_verified(result)),
        conformity=list(
            _conformities(result, section, promised, head.tolerance, location)
        ),
        conditions=conditions(result),
    )


def _estimate(result: StudyResult, file: str) -> EstimateSection | CorrectedSection:
    section = estimated_section(result, Path(file).parent)
    if any(p.truth is not None for p in section.parameters.values()):
        raise InputError(
            "its readings are simulated, and a certificate is about a machine",
            "identify from readings: `oed identify STUDY --readings CSV --out DIR`",
            file=file,
        )
    return section


def _counts(name: str, sd: float) -> bool:
    """Whether an estimate is of the machine, not of a set-up, and not fixed."""
    return "." not in name and sd > 0.0


def _parameter(
    machine: Machine, section: EstimateSection | CorrectedSection, name: str
) -> CertifiedParameter:
    p, parameter = section.parameters[name], machine.parameters[machine.index(name)]
    scale = units.factor(p.unit)
    source = SOURCES[p.identified]
    return CertifiedParameter(
        name, parameter.about, p.value * scale, p.sd * scale, parameter.unit, source
    )


def conditions(result: StudyResult) -> list[str]:
    over_answers = not result.corrects_effects and result.controller_mixture is not None
    sentences = [NORMAL, OVER_ANSWERS if over_answers else ACCURACY]
    if result.verification is not None:
        sentences.append(CHECKED)
    if result.corrected is not None:
        sentences += result.corrected.conditions
        for name, e in result.corrected.effects.items():
            sentences.append(
                f"{name} of the effect {e.effect} was estimated with the parameters:"
                f" {e.value:.4g}, standard uncertainty {e.sd:.2g} {e.unit}"
            )
    final = result.final_estimate
    return sentences if final is None else [*sentences, *final.warnings]


def _predicted(
    result: StudyResult, promised: PromisedAccuracy
) -> Iterator[CertifiedAccuracy]:
    """Predicted errors of the driven components; from the covariance without a table."""
    prediction = result.judged_prediction
    if prediction is None or prediction.mode == "plan":
        root = covariance_root(promised.promise.covariances[0])
        for k, component in enumerate(promised.components):
            sd = np.linalg.norm(promised.promise.maps[:, k] @ root, axis=1)
            rms = promised.promise.rms[k]
            largest = sd.max()
            yield CertifiedAccuracy(
                component.name, float(rms), float(largest), component.unit
            )
        return
    for name, accuracy in prediction.components.items():
        s = accuracy.after
        scale = units.factor(s.unit)
        ends = s.rms_interval
        yield CertifiedAccuracy(
            name,
            s.rms * scale,
            s.max * scale,
            units.si_unit(s.unit),
            p95=s.p95 * scale,
            interval=None if ends is None else (ends[0] * scale, ends[1] * scale),
        )


def _verified(result: StudyResult) -> Iterator[CertifiedAccuracy]:
    """Measured errors of the acceptance test."""
    if result.verification is None:
        return
    for name, c in result.verification.components.items():
        scale = units.factor(c.unit)
        yield CertifiedAccuracy(
            name,
            c.rms * scale,
            c.max * scale,
            units.si_unit(c.unit),
            limit=c.limit * scale,
            verdict=c.judgement,
        )


#
# Probability that a true value lies within its tolerance, from what is known of it.
#
# JCGM 106:2012: where g is the density of a quantity Y after all that is known, and the
# tolerance is [T_L, T_U], the probability of conformity is
#
# p = int_{T_L}^{T_U} g(y) dy.
#
# A parameter is normal. The rms error of a pose component over m poses is that of a field
# b + J d, where b is known in advance and d is normal.

#: machines drawn: the standard error of a probability is at most 0.0022
N_MACHINES = 50_000


def parameter_within(value: float, sd: float, low: float, high: float) -> float:
    """Probability that a normal quantity lies between two limits."""
    return float(special.ndtr((high - value) / sd) - special.ndtr((low - value) / sd))


def rms_within(
    known_errors: Array,
    slopes: Array,
    root: Array,
    largest: float,
    rng: np.random.Generator,
) -> float:
    """Probability that the rms of errors known + slopes d is at most `largest`.

    known_errors  (m,) errors that stay and are known
    slopes  (m, p) errors per parameter
    root    (p, k) with root @ root.T the covariance of d
    """
    spread = slopes @ root
    normal = rng.standard_normal((N_MACHINES, root.shape[1]))
    squares = np.einsum("dk,kl,dl->d", normal, spread.T @ spread, normal, optimize=True)
    squares += 2.0 * (normal @ (spread.T @ known_errors)) + known_errors @ known_errors
    return float(np.mean(np.sqrt(squares / len(known_errors)) <= largest))


def _conformities(
    result: StudyResult,
    section: EstimateSection | CorrectedSection,
    promised: PromisedAccuracy,
    tolerance: Mapping[str, float],
    location: Location,
) -> Iterator[Conformity]:
    """Conformity with each tolerance, or with what an acceptance test promised."""
    unit_of = {p.name: p.unit for p in promised.machine.parameters}
    unit_of |= {c.name: c.unit for c in promised.machine.components}
    stated = quantities.read_values(tolerance, unit_of, location)
    if not stated and result.acceptance is not None:
        demands = result.acceptance.components
        stated = {n: d.promised * units.factor(d.unit) for n, d in demands.items()}
    fields = _error_fields(promised)
    for name, largest in stated.items():
        unit = unit_of[name]
        if name in fields:
            yield _predicted_conformity(result, name, fields[name], largest, unit)
            yield from _measured_conformity(result, name, largest, unit)
        elif name in section.parameters and _counts(name, section.parameters[name].sd):
            yield _parameter_conformity(section, name, largest, unit)
        else:
            known = ", ".join([*fields, *section.parameters])
            raise location.error(
                f"nothing is known of {name} that a tolerance could be compared with",
                f"remove it, or name one of {known}",
            )


class _ErrorField(NamedTuple):
    """Errors of a component over the workspace: known ones, and those of parameters."""

    promise: Promise
    k: int  #: of the component in the promise
    known: Array  #: (m,) SI
    basis: str

    def probability_within(self, largest: float, seed: int) -> float:
        """Probability by the geometry alone; errors have the predicted size."""
        promise, k = self.promise, self.k
        rng = np.random.default_rng([seed, zlib.crc32(promise.names[k].encode())])
        root = covariance_root(promise.covariances[0])
        slopes = promise.maps[:, k]
        size = np.linalg.norm(slopes @ root) / np.sqrt(len(slopes))
        scaled = root * (promise.rms[k] / size)
        return rms_within(self.known, slopes, scaled, largest, rng)


def _error_fields(promised: PromisedAccuracy) -> dict[str, _ErrorField]:
    """The errors of each component, driven or not."""
    promise, further = promised.promise, promised.further
    basis = "predicted from the calibration, over the workspace"
    nothing = np.zeros(len(promise.maps))
    fields = {
        c.name: _ErrorField(promise, k, nothing, basis)
        for k, c in enumerate(promised.components)
    }
    if further is not None:
        basis = "predicted, no drive corrects it, over the workspace"
        for k, c in enumerate(further.components):
            fields[c.name] = _ErrorField(further.promise, k, further.known[:, k], basis)
    return fields


def _predicted_conformity(
    result: StudyResult, name: str, field: _ErrorField, largest: float, unit: str
) -> Conformity:
    """Conformity of a prediction: over the distribution that every verdict rests on.

    By the geometry alone where no such distribution is stored.
    """
    prediction = result.judged_prediction
    stored = None if prediction is None else prediction.components[name].after
    if stored is None or not stored.rms_quantiles:
        basis, can_pass = f"{field.basis}, {GEOMETRY_ALONE}", False
        probability = field.probability_within(largest, result.seed)
    else:
        limit = units.number(largest, stored.unit)
        probability = stored.probability_within(limit)
        verdict = accuracy_verdicts(result, {name: limit})[name]
        can_pass = verdict.confirmed and verdict.judgement == "pass"
        basis = f"{field.basis}, {verdict.scope}"
        if not verdict.confirmed:
            basis += "; no measurement confirms it"
    return Conformity(
        f"rms error of {name}", basis, largest, unit, probability, can_pass
    )


def _measured_conformity(
    result: StudyResult, name: str, largest: float, unit: str
) -> Iterator[Conformity]:
    verified, plan = result.verification, result.acceptance
    if verified is None or plan is None or name not in verified.components:
        return
    verdict = verified.components[name]
    scale = units.factor(plan.components[name].unit)
    p = measured_rms_within(
        verdict.rms * scale,
        plan.components[name].uncertainty * scale,
        len(plan.poses),
        largest,
    )
    basis = "measured at the acceptance poses"
    yield Conformity(f"rms error of {name}", basis, largest, unit, p)


def _parameter_conformity(
    section: EstimateSection | CorrectedSection, name: str, largest: float, unit: str
) -> Conformity:
    p = section.parameters[name]
    scale = units.factor(p.unit)
    probability = parameter_within(
        (p.value - p.nominal) * scale, p.sd * scale, -largest, largest
    )
    quantity = f"{name}, departure from nominal"
    return Conformity(quantity, "identified", largest, unit, probability)


# Writes the certificate of a result's folder: Digital Calibration Certificate and PDF.

XML = "certificate.xml"


def certify_folder(
    folder: Path,
    *,
    head_file: Path | None = None,
    study_file: Path | None = None,
    consent: Consent = Consent.RECORDED,
) -> tuple[Certificate, tuple[Path, ...]]:
    """Write the certificate of a result; what it states, and the written files.

    head_file   what no calibration knows: certificate.toml of the folder by default
    study_file  study, where it names a machine in a file of its own
    consent     to run that file

    Raises InputError, and BadFitError where nothing should rest on the fit.
    """
    from pkm_certificate.pdf import write_certificate_page

    result = load_result(folder)
    refuse_bad_fit(result)
    path = folder / head.FILE if head_file is None else head_file
    stated = head.read(path)
    study = result_study(result, folder, study_file, consent)
    file, tolerance_file = str(folder / "result.json"), Location(str(path), "tolerance")
    record = certificate(result, study, stated, file, tolerance_file)
    written = safe_files.write_own(folder / XML, dcc.write_xml(record))
    return record, (written, write_certificate_page(record, folder))


def sentences(certificate: Certificate) -> Iterator[str]:
    """Conformity, for a terminal."""
    entries = zip(certificate.conformity, certificate.verdicts, strict=True)
    for c, verdict in entries:
        unit = units.FINE[c.unit]
        yield (
            f"{c.quantity}, {c.basis}: within {units.number(c.tolerance, unit):.4g} {unit}"
            f" with probability {c.probability:.3f}{f': {verdict}' if verdict else ''}."
        )
    if not certificate.conformity:
        yield "No tolerance is stated, so the certificate states no conformity."
