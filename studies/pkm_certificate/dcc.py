"""A certificate as Digital Calibration Certificate: XML of PTB's schema 3.2.1, D-SI 2.1.0.

Administrative data are those of the user. Each parameter is a quantity with its expanded
uncertainty; all of them together are a list with their covariance matrix and the
ellipsoid that holds 95 % of their joint distribution.
"""

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree

import numpy as np
from scipy import special

from oed.result import Judgement
from pkm_certificate.statement import (
    Certificate,
    CertificateHead,
    CertifiedAccuracy,
    CertifiedParameter,
    Institution,
)

Element = ElementTree.Element
VERSION = "3.2.1"
DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
#: D-SI names of the SI units of parameters and errors
UNITS = {
    "m": r"\metre",
    "rad": r"\radian",
    "s": r"\second",
    "N": r"\newton",
    "K": r"\kelvin",
    "1": r"\one",
}
#: coverage factor of expanded uncertainties, and its probability of a normal quantity
FACTOR, PROBABILITY = "2", "0.9545"
JOINT_PROBABILITY = 0.95
#: words of the schema for the verdicts
CONFORMITY: dict[Judgement, str] = {
    "pass": "pass",
    "fail": "fail",
    "cannot tell": "noPass",
}
ZERO_CELSIUS = 273.15  # K
JCGM = "JCGM 106:2012"
METHOD = (
    "Parameters of a kinematic model were identified from readings by weighted least"
    " squares with their tolerances as prior; the covariance is that of the linearised"
    " posterior."
)


def write_xml(certificate: Certificate) -> bytes:
    """The certificate as XML in UTF-8; the same certificate gives the same bytes."""
    for prefix, name in (("dcc", DCC), ("si", SI), ("xsi", XSI)):
        ElementTree.register_namespace(prefix, name)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=VERSION)
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {DCC}/v{VERSION}/dcc.xsd")
    _administrative(_add(root, "administrativeData"), certificate)
    _results(_add(root, "measurementResults"), certificate)
    ElementTree.indent(root)
    text: str = ElementTree.tostring(root, "unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'.encode()


def _add(parent: Element, name: str, text: str = "", space: str = DCC) -> Element:
    element = ElementTree.SubElement(parent, f"{{{space}}}{name}")
    element.text = text or None
    return element


def _words(parent: Element, name: str, text: str) -> None:
    content = _add(_add(parent, name), "content", text)
    content.set("lang", "en")


def _administrative(parent: Element, c: Certificate) -> None:
    _software(_add(parent, "dccSoftware"), c)
    _core(_add(parent, "coreData"), c.head)
    _item(_add(_add(parent, "items"), "item"), c)
    laboratory = _add(parent, "calibrationLaboratory")
    if c.head.laboratory.accreditation:
        _add(laboratory, "calibrationLaboratoryCode", c.head.laboratory.accreditation)
    _contact(_add(laboratory, "contact"), c.head.laboratory)
    persons = _add(parent, "respPersons")
    for person in c.head.person:
        entry = _add(persons, "respPerson")
        _words(_add(entry, "person"), "name", person.name)
        if person.role:
            _add(entry, "role", person.role)
        if person.signs:
            _add(entry, "mainSigner", "true")
    _contact(_add(parent, "customer"), c.head.customer)


def _software(parent: Element, c: Certificate) -> None:
    software = _add(parent, "software")
    _words(software, "name", "pkm-oed")
    _add(software, "release", f"v{c.version}")


def _core(core: Element, head: CertificateHead) -> None:
    _add(core, "countryCodeISO3166_1", head.country)
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", head.identifier)
    _add(core, "beginPerformanceDate", head.begin)
    _add(core, "endPerformanceDate", head.end)
    _add(core, "performanceLocation", head.place)
    if head.issued:
        _add(core, "issueDate", head.issued)


def _item(item: Element, c: Certificate) -> None:
    _words(item, "name", c.machine)
    _words(item, "description", c.about or c.machine)
    if c.head.item.manufacturer:
        _words(_add(item, "manufacturer"), "name", c.head.item.manufacturer)
    if c.head.item.model:
        _add(item, "model", c.head.item.model)
    _serial_number(item, c.head.item.serial)


def _serial_number(parent: Element, value: str) -> None:
    entry = _add(_add(parent, "identifications"), "identification")
    _add(entry, "issuer", "manufacturer")
    _add(entry, "value", value)
    _words(entry, "name", "Serial number")


def _contact(parent: Element, contact: Institution) -> None:
    _words(parent, "name", contact.name)
    if contact.email:
        _add(parent, "eMail", contact.email)
    location = _add(parent, "location")
    _add(location, "city", contact.city)
    _add(location, "countryCode", contact.country)
    if contact.post_code:
        _add(location, "postCode", contact.post_code)
    if contact.street:
        _add(location, "street", contact.street)


def _results(parent: Element, c: Certificate) -> None:
    calibration = _add(parent, "measurementResult")
    _words(calibration, "name", "Calibration")
    methods = _add(calibration, "usedMethods")
    method = _add(methods, "usedMethod")
    _words(method, "name", "Identification of parameters")
    _words(method, "description", f"{METHOD} Study: {c.study}. {c.readings} readings.")
    if c.conformity:
        method = _add(methods, "usedMethod")
        _words(method, "name", "Probability of conformity")
        _add(method, "norm", JCGM)
    _software(_add(calibration, "usedSoftware"), c)
    _equipment(calibration, c)
    _conditions(calibration, c)
    results = _add(calibration, "results")
    _parameters(results, c)
    _accuracy(results, "Predicted accuracy", c.predicted, _prediction_text(c))
    if c.verified:
        about = f"Errors measured at {c.verified_poses} acceptance poses."
        _accuracy(results, "Verified accuracy", c.verified, about)
    _conformity(results, c)
    meta = _add(_add(calibration, "measurementMetaData"), "metaData")
    _words(meta, "name", "Conditions")
    sentences = [f"{s[0].upper()}{s[1:].rstrip('.')}." for s in c.conditions]
    _words(meta, "declaration", " ".join(sentences))


def _prediction_text(c: Certificate) -> str:
    return (
        f"Predicted errors after compensation over {c.poses} poses; reference:"
        f" {c.reference}."
    )


def _equipment(parent: Element, c: Certificate) -> None:
    if not c.head.instrument:
        return
    listed = _add(parent, "measuringEquipments")
    for instrument in c.head.instrument:
        entry = _add(listed, "measuringEquipment")
        _words(entry, "name", instrument.name)
        if instrument.certificate:
            number = f"Calibration certificate {instrument.certificate}"
            _words(entry, "description", number)
        if instrument.serial:
            _serial_number(entry, instrument.serial)


def _conditions(parent: Element, c: Certificate) -> None:
    temperature = c.head.temperature
    if temperature is None:
        return
    entry = _add(_add(parent, "influenceConditions"), "influenceCondition")
    _words(entry, "name", "Temperature")
    quantity = _quantity(_add(entry, "data"), "Temperature")
    _real(quantity, round(temperature + ZERO_CELSIUS, 6), "K")


def _result(parent: Element, name: str, about: str) -> Element:
    result = _add(parent, "result")
    _words(result, "name", name)
    if about:
        _words(result, "description", about)
    return _add(result, "data")


def _quantity(parent: Element, name: str, about: str = "") -> Element:
    quantity = _add(parent, "quantity")
    _words(quantity, "name", name)
    if about:
        _words(quantity, "description", about)
    return quantity


def _real(quantity: Element, value: float, unit: str) -> Element:
    real = _add(quantity, "real", space=SI)
    _add(real, "value", repr(float(value)), SI)
    _add(real, "unit", UNITS[unit], SI)
    return real


def _parameters(results: Element, c: Certificate) -> None:
    parameters = c.parameters
    data = _result(results, "Parameters of the kinematic model", "")
    listed = _add(data, "list")
    for p in parameters:
        quantity = _quantity(listed, p.name, f"{p.about}; {p.source}")
        expanded = _add(_real(quantity, p.value, p.unit), "expandedUnc", space=SI)
        _add(expanded, "uncertainty", repr(2.0 * p.sd), SI)
        _add(expanded, "coverageFactor", FACTOR, SI)
        _add(expanded, "coverageProbability", PROBABILITY, SI)
        _add(expanded, "distribution", "normal", SI)
    data = _result(results, "Covariance of the parameters", "")
    joint = _quantity(data, "All parameters, with their covariance matrix")
    values = _add(joint, "realListXMLList", space=SI)
    for name, phrase in (
        ("labelXMLList", [p.name for p in parameters]),
        ("valueXMLList", [repr(p.value) for p in parameters]),
        ("unitXMLList", [UNITS[p.unit] for p in parameters]),
    ):
        _add(values, name, " ".join(phrase), SI)
    region = _add(values, "ellipsoidalRegionXMLList", space=SI)
    _covariance(_add(region, "covarianceMatrix", space=SI), parameters, c.covariance)
    factor = np.sqrt(special.chdtri(len(parameters), 1.0 - JOINT_PROBABILITY))
    _add(region, "coverageFactor", f"{factor:.6f}", SI)
    _add(region, "coverageProbability", str(JOINT_PROBABILITY), SI)
    _add(region, "distribution", "normal", SI)


def _covariance(
    parent: Element,
    parameters: Sequence[CertifiedParameter],
    covariance: Sequence[Sequence[float]],
) -> None:
    for p, row in zip(parameters, covariance, strict=True):
        column = _add(parent, "column", space=SI)
        for other, value in zip(parameters, row, strict=True):
            entry = _add(column, "covariance", space=SI)
            _add(entry, "value", repr(float(value)), SI)
            _add(entry, "unit", product(p.unit, other.unit), SI)


def product(first: str, second: str) -> str:
    """D-SI unit of a product."""
    if first == second:
        return UNITS[first] if first == "1" else UNITS[first] + r"\tothe{2}"
    return "".join(UNITS[u] for u in (first, second) if u != "1")


def _accuracy(
    results: Element, title: str, accuracies: Sequence[CertifiedAccuracy], about: str
) -> None:
    listed = _add(_result(results, title, about), "list")
    for a in accuracies:
        for name, value in figures(a):
            quantity = _quantity(listed, f"{name} of {a.component}")
            _real(quantity, value, a.unit)
            if a.verdict is not None and name == "rms error":
                phrase = "Acceptance test: the machine meets its promised rms error."
                _statement(quantity, phrase, a.verdict)


def figures(a: CertifiedAccuracy) -> Iterator[tuple[str, float]]:
    """Name and value, SI, of each figure of a component's errors."""
    yield "rms error", a.rms
    if a.interval is not None:
        yield "lower end of the 95 % interval of the rms error", a.interval[0]
        yield "upper end of the 95 % interval of the rms error", a.interval[1]
    if a.p95 is not None:
        yield "95th percentile of the error", a.p95
    yield "largest error", a.max
    if a.limit is not None:
        yield "limit of the rms error", a.limit


def _conformity(results: Element, c: Certificate) -> None:
    if not c.conformity:
        return
    about = "Probability that the true value lies within its tolerance."
    listed = _add(_result(results, "Probability of conformity", about), "list")
    for entry, verdict in zip(c.conformity, c.verdicts, strict=True):
        part = _add(listed, "list")
        _words(part, "name", f"{entry.quantity}: {entry.basis}")
        _real(_quantity(part, "tolerance"), entry.tolerance, entry.unit)
        quantity = _quantity(part, "probability of conformity")
        _real(quantity, round(entry.probability, 4), "1")
        if verdict:
            phrase = (
                f"Decision rule: conforming from a probability of {c.head.decision} on,"
                " not conforming where that of the contrary reaches it. A prediction that"
                " no measurement confirms is not stated as conforming."
            )
            _statement(quantity, phrase, verdict)


def _statement(quantity: Element, phrase: str, verdict: Judgement) -> None:
    meta = _add(_add(quantity, "measurementMetaData"), "metaData")
    _words(meta, "declaration", phrase)
    _add(meta, "conformity", CONFORMITY[verdict])
