"""The certificate as PDF: head, parameters with uncertainties, accuracy, conformity."""

from collections.abc import Sequence
from pathlib import Path

from oed import units
from oed.safe_files import write_own
from pkm_certificate.statement import Certificate, CertifiedAccuracy, Institution
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Facts,
    Items,
    Paragraph,
    Section,
    Table,
    TableColumn,
)
from pkm_reports.page import Content, Document

#: parameters up to which their covariance fits on a page
MAX_COVARIANCE_PARAMETERS = 12


def write_certificate_page(certificate: Certificate, folder: Path) -> Path:
    """Write `certificate.pdf` into a folder and return its path. Raises OSError."""
    c = certificate
    answer = [
        Section("head", "Machine, laboratory and customer", [_head(c)]),
        Section("conformity", "Conformity", _conformity(c)),
        Section("accuracy", "Accuracy", _accuracy(c)),
        Section(
            "conditions",
            "What the figures rest on",
            [Items([f"{s[0].upper()}{s[1:].rstrip('.')}." for s in c.conditions])],
        ),
    ]
    content = Content(
        title="Calibration certificate",
        question=c.head.identifier,
        study=c.study,
        machine=c.machine,
        foot=f"{c.head.identifier} · {c.study} · pkm-oed {c.version}",
        answer=answer,
        chapters=[Section("parameters", "Parameters", _parameters(c))],
        appendix=[],
    )
    page = Document(content).pdf()
    return write_own(folder / "certificate.pdf", page)


def _head(c: Certificate) -> Facts:
    head = c.head
    item = [
        head.item.manufacturer,
        head.item.model,
        f"serial number {head.item.serial}",
    ]
    rows = [
        ("Machine", f"{c.machine}: {c.about}" if c.about else c.machine),
        ("Item", _joined(item)),
        ("Laboratory", _contact(head.laboratory)),
        ("Accreditation", head.laboratory.accreditation),
        ("Customer", _contact(head.customer)),
        ("Calibrated", f"{head.begin} to {head.end}, place: {head.place}"),
        ("Temperature", _temperature(head.temperature)),
        ("Issued", head.issued),
        ("Instruments", "; ".join(_instruments(c))),
        ("Readings", f"{c.readings} values of {'; '.join(c.setups)}"),
        ("Responsible", "; ".join(_joined([p.name, p.role]) for p in head.person)),
    ]
    return Facts([(term, phrase) for term, phrase in rows if phrase])


def _temperature(value: float | None) -> str:
    return "" if value is None else f"{value:g} °C"


def _joined(parts: Sequence[str]) -> str:
    return ", ".join(part for part in parts if part)


def _contact(contact: Institution) -> str:
    town = " ".join(part for part in (contact.post_code, contact.city) if part)
    parts = [contact.name, contact.street, town, contact.country, contact.email]
    return _joined(parts)


def _instruments(c: Certificate) -> list[str]:
    return [
        _joined(
            [
                i.name,
                i.serial and f"serial number {i.serial}",
                i.certificate and f"certificate {i.certificate}",
            ]
        )
        for i in c.head.instrument
    ]


def _parameters(c: Certificate) -> list[Block]:
    rows = []
    for p in c.parameters:
        unit = units.display(p.unit)
        value, twice = (units.number(v, unit) for v in (p.value, 2.0 * p.sd))
        cells = [p.name, text.number(value, 8), text.number(twice, 2), unit]
        rows.append([*cells, f"{p.about}; {p.source}"])
    columns = [
        *TableColumn.texts("Parameter"),
        *TableColumn.numbers("Value", "U"),
        *TableColumn.texts("Unit"),
        TableColumn("What it is, and where the value comes from", wide=True),
    ]
    caption = "Identified parameters. U: expanded uncertainty, coverage factor 2."
    blocks: list[Block] = [Table(columns, rows, caption)]
    if len(c.parameters) > MAX_COVARIANCE_PARAMETERS:
        blocks.append(Paragraph("certificate.xml has their covariance matrix."))
        return blocks
    blocks.append(_covariance(c))
    return blocks


def _covariance(c: Certificate) -> Table:
    names = [p.name for p in c.parameters]
    rows = [
        [name, *(text.number(value, 3) for value in row)]
        for name, row in zip(names, c.covariance, strict=True)
    ]
    caption = "Covariance of the parameters, in products of their SI units."
    return Table([*TableColumn.texts(""), *TableColumn.numbers(*names)], rows, caption)


def _accuracy(c: Certificate) -> list[Block]:
    caption = (
        f"Predicted errors after compensation, over {c.poses} poses; reference:"
        f" {c.reference}."
    )
    blocks: list[Block] = [_errors(c.predicted, caption)]
    if c.verified:
        caption = f"Errors measured at {c.verified_poses} acceptance poses."
        blocks.append(_errors(c.verified, caption))
    else:
        blocks.append(Paragraph("No acceptance test was judged."))
    return blocks


def _errors(accuracies: Sequence[CertifiedAccuracy], caption: str) -> Table:
    rows = []
    for a in accuracies:
        unit = units.FINE[a.unit]
        figures = [
            "" if v is None else text.number(units.number(v, unit), 3)
            for v in (a.rms, a.p95, a.max, a.limit)
        ]
        rows.append([a.component, *figures, unit, a.verdict or ""])
    columns = [
        *TableColumn.texts("Component"),
        *TableColumn.numbers("Rms", "95th percentile", "Largest", "Limit of rms"),
        *TableColumn.texts("Unit", "Verdict"),
    ]
    return Table(columns, rows, caption)


def _conformity(c: Certificate) -> list[Block]:
    if not c.conformity:
        return [Paragraph("No tolerance is stated.")]
    rows = []
    for entry, verdict in zip(c.conformity, c.verdicts, strict=True):
        unit = units.FINE[entry.unit]
        tolerance = text.number(units.number(entry.tolerance, unit), 4)
        probability = f"{entry.probability:.3f}"
        rows.append(
            [entry.quantity, tolerance, unit, probability, verdict or "", entry.basis]
        )
    columns = [
        *TableColumn.texts("Quantity"),
        *TableColumn.numbers("Tolerance"),
        *TableColumn.texts("Unit"),
        *TableColumn.numbers("Probability"),
        *TableColumn.texts("Verdict"),
        TableColumn("Rests on", wide=True),
    ]
    caption = (
        "Probability that the true value lies within its tolerance (JCGM 106:2012)."
    )
    if c.head.decision is not None:
        caption += (
            f" Decision rule: pass from {c.head.decision} on, fail where the contrary"
            " reaches it, else cannot tell. A prediction that no measurement confirms is"
            " stated with its probability alone, and never as pass."
        )
    return [Table(columns, rows, caption)]
