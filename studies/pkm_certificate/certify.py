"""Writes the certificate of a result's folder: Digital Calibration Certificate and PDF."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from oed import safe_files, units
from oed.certificate import Certificate
from pkm_certificate import build, dcc, head
from pkm_studies.compensation import result_study
from pkm_studies.results import load_result, refuse_bad_fit
from pkm_studies.user_code import Consent

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
    from pkm_reports import write_certificate_page

    result = load_result(folder)
    refuse_bad_fit(result)
    path = folder / head.FILE if head_file is None else head_file
    stated, tolerance = head.read(path)
    study = result_study(result, folder, study_file, consent)
    file, place = str(folder / "result.json"), build.tolerance_place(path)
    certificate = build.certificate(result, study, stated, tolerance, file, place)
    written = safe_files.write_own(folder / XML, dcc.write_xml(certificate))
    return certificate, (written, write_certificate_page(certificate, folder))


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
