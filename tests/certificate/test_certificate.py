"""`oed certificate`: PTB's schema, a public reader, conformity, and what is asked for."""

import json
import os
import re
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture
from lxml import etree
from result_sample import whole
from scipy import stats

from oed.acceptance import measured_rms_within
from oed.result import StudyResult, VerdictRecord, VerificationSection
from pkm_certificate import build
from pkm_certificate.build import parameter_within, rms_within
from pkm_certificate.dcc import product
from pkm_certificate.statement import Certificate
from pkm_studies.commands import main

Run = Callable[..., tuple[int, str, str]]
ROOT = Path(__file__).resolve().parents[2]
#: dcc.xsd of version 3.2.1 and SI_Format.xsd of version 2.1.0, as published by PTB
SCHEMAS = Path(os.environ.get("DCC_SCHEMAS", ROOT.parent / "shared" / "dcc_schema"))
#: signatures are no part of the certificate
SIGNATURE = """\
<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema"
  targetNamespace="http://www.w3.org/2000/09/xmldsig#"><xs:element name="Signature"/>
</xs:schema>"""
STUDY = """\
schema = 1
name = "small_delta"
[machine]
model = "linear_delta"
[[setup]]
name = "camera"
instrument = "camera_known_frame"
[noise]
read_x_um = 20.0
read_y_um = 20.0
read_z_um = 20.0
[design]
criterion = "D"
readings = 16
[[design.candidates]]
setup = "camera"
x_mm = [-80.0, 0.0, 80.0]
y_mm = [-80.0, 0.0, 80.0]
z_mm = [10.0, 200.0]
[prediction]
x_mm = [-60.0, 0.0, 60.0]
y_mm = [-60.0, 60.0]
z_mm = [20.0, 150.0]
[identify]
effects = ["encoder_scale"]
[posterior]
enabled = false
[report]
html = false
pdf = false
"""
HEAD = """\
identifier = "K-17 & <1>"
country = "DE"
begin = "2026-03-01"
end = "2026-03-02"
place = "laboratory"
temperature_C = 20.5
decision = 0.95
[item]
serial = "0815"
[laboratory]
name = "Room 4"
city = "Ulm"
country = "DE"
[customer]
name = "A printer's owner"
city = "Bern"
country = "CH"
[[person]]
name = "N. N."
signs = true
[[instrument]]
name = "camera"
serial = "3"
[tolerance]
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result of readings from a file, with a certificate's head."""
    folder = tmp_path_factory.mktemp("certificate")
    study, readings = folder / "small.study.toml", folder / "r.readings.csv"
    study.write_text(STUDY, encoding="utf-8")
    out = folder / "out"
    assert main(["simulate", str(study), "--out", str(readings)]) == 0
    call = ["identify", str(study), "--readings", str(readings), "--out", str(out)]
    assert main([*call, "--quiet"]) == 0
    return out


@pytest.fixture
def folder(session: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(session, tmp_path / "out"))


def stored(folder: Path) -> StudyResult:
    return msgspec.json.decode((folder / "result.json").read_bytes(), type=StudyResult)


def state(folder: Path, tolerance: str = "", head: str = HEAD) -> None:
    (folder / "certificate.toml").write_text(head + tolerance, encoding="utf-8")


def certified(folder: Path, tolerance: str) -> Certificate:
    state(folder, tolerance)
    return build.certify_folder(folder)[0]


def with_acceptance(folder: Path, oed: Run) -> None:
    """An acceptance test of the folder, judged with errors of 0.8 of the promise."""
    assert oed("verify", folder)[0] == 0
    result = stored(folder)
    verdicts = {
        name: VerdictRecord(
            rms=0.8 * d.promised,
            max=d.promised,
            limit=d.limit,
            promised=d.promised,
            unit=d.unit,
            passed=True,
        )
        for name, d in result.acceptance.components.items()
    }
    judged = VerificationSection(True, len(result.acceptance.poses), verdicts)
    result = msgspec.structs.replace(result, verification=judged)
    (folder / "result.json").write_bytes(msgspec.json.encode(result))


def schema(folder: Path) -> etree.XMLSchema:
    if not (SCHEMAS / "dcc.xsd").is_file():
        pytest.skip(f"PTB's dcc.xsd and SI_Format.xsd are not in {SCHEMAS}")
    text = (SCHEMAS / "dcc.xsd").read_text(encoding="utf-8")
    for name in ("SI_Format.xsd", "xmldsig-core-schema.xsd"):
        text = re.sub(rf'"[^"]*{name}"', f'"{name}"', text)
    (folder / "dcc.xsd").write_text(text, encoding="utf-8")
    shutil.copy(SCHEMAS / "SI_Format.xsd", folder)
    (folder / "xmldsig-core-schema.xsd").write_text(SIGNATURE, encoding="utf-8")
    return etree.XMLSchema(etree.parse(folder / "dcc.xsd"))


def test_the_xml_is_valid(folder, tmp_path, oed):
    known = schema(tmp_path)
    with_acceptance(folder, oed)
    state(folder, "z_um = 30.0\narm1_mm = 0.1\n")
    assert oed("certificate", folder)[0] == 0
    known.assertValid(etree.parse(folder / "certificate.xml"))
    # the least that a user may state
    optional = ("temperature", "decision", "signs")
    lines = [line for line in HEAD.splitlines() if not line.startswith(optional)]
    head = "\n".join(lines).replace('[[instrument]]\nname = "camera"\nserial = "3"', "")
    state(folder, head=head)
    assert oed("certificate", folder)[0] == 0
    known.assertValid(etree.parse(folder / "certificate.xml"))


def every(data: Any, key: str) -> list[Any]:
    """Values of a key at any depth, in order."""
    if isinstance(data, list):
        return [v for item in data for v in every(item, key)]
    if not isinstance(data, dict):
        return []
    inner = [v for item in data.values() for v in every(item, key)]
    return [*([data[key]] if key in data else []), *inner]


def text(node: Any) -> str:
    return str(node["dcc:content"]["#text"])


def test_a_public_reader_reads_the_values_back(folder, oed):
    from dccXMLJSONConv.dccConv import XMLToJson

    state(folder, "z_um = 30.0\n")
    code, out, _ = oed("certificate", folder)
    assert code == 1  # no measurement confirms the prediction
    assert "rms error of z" in out
    assert "no measurement confirms it" in out
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = XMLToJson((folder / "certificate.xml").read_text("utf-8"))
    read = json.loads(json.dumps(read))["dcc:digitalCalibrationCertificate"]
    core = read["dcc:administrativeData"]["dcc:coreData"]
    assert core["dcc:uniqueIdentifier"]["#text"] == "K-17 & <1>"
    results = every(read, "dcc:result")[0]
    quantities = results[0]["dcc:data"]["dcc:list"]["dcc:quantity"]
    section = json.loads((folder / "result.json").read_text("utf-8"))["estimate"]
    size = {"mm": (1e-3, r"\metre"), "mrad": (1e-3, r"\radian")}
    expected = {n: p for n, p in section["parameters"].items() if p["sd"] > 0.0}
    assert [text(q["dcc:name"]) for q in quantities] == list(expected)
    for quantity, p in zip(quantities, expected.values(), strict=True):
        real, (scale, unit) = quantity["si:real"], size[p["unit"]]
        assert float(real["si:value"]["#text"]) == pytest.approx(scale * p["value"])
        assert real["si:unit"]["#text"] == unit
        twice = float(real["si:expandedUnc"]["si:uncertainty"]["#text"])
        assert twice == pytest.approx(2 * scale * p["sd"])
    columns = every(results[1], "si:column")[0]
    cells = [
        [float(v["si:value"]["#text"]) for v in c["si:covariance"]] for c in columns
    ]
    at = [list(section["parameters"]).index(name) for name in expected]
    scales = np.array([size[p["unit"]][0] for p in expected.values()])
    covariance = np.array(section["covariance"])[np.ix_(at, at)]
    np.testing.assert_allclose(cells, covariance * np.outer(scales, scales), rtol=1e-12)
    assert product("m", "rad") == r"\metre\radian"
    assert product("K", "K") == r"\kelvin\tothe{2}"
    assert (product("1", "1"), product("1", "m")) == (r"\one", r"\metre")
    assert (folder / "certificate.pdf").read_bytes().startswith(b"%PDF")


def test_probabilities_against_other_code(rng):
    normal = stats.norm(0.3, 0.2)
    inside = normal.cdf(0.5) - normal.cdf(-0.5)
    assert parameter_within(0.3, 0.2, -0.5, 0.5) == pytest.approx(inside)
    # one pose, one parameter: |b + s d| <= t
    p = rms_within(np.array([0.3]), np.eye(1), 0.2 * np.eye(1), 0.5, rng)
    assert p == pytest.approx(inside, abs=0.01)
    # independent errors of one size: chi-squared
    p = rms_within(np.zeros(4), np.eye(4), np.eye(4), 1.1, rng)
    assert p == pytest.approx(stats.chi2(4).cdf(4 * 1.21), abs=0.01)
    # measured errors: drawn about the readings
    measured = rng.normal(0.0, 1.0, 9)
    rms = np.sqrt(np.mean(measured**2))
    true = measured + 0.4 * rng.standard_normal((200_000, 9))
    share = np.mean(np.sqrt(np.mean(true**2, axis=1)) <= 1.05 * rms)
    p = measured_rms_within(rms, 0.4, 9, 1.05 * rms)
    assert p == pytest.approx(share, abs=0.005)


def test_conformity_of_the_machine(folder, oed):
    with_acceptance(folder, oed)
    section = stored(folder).estimate
    off = stored(folder).prediction.components["z"].after.rms
    tolerance = f"z_um = {off}\narm1_mm = 0.5\n"
    entries = certified(folder, tolerance).conformity
    assert [e.quantity.split()[0] for e in entries] == ["rms", "rms", "arm1,"]
    predicted, measured, arm = entries
    assert 0.5 < predicted.probability < 0.75  # the rms is above the median of the rms
    acceptance = stored(folder).acceptance
    n, u = len(acceptance.poses), acceptance.components["z"].uncertainty
    rms = 0.8 * acceptance.components["z"].promised
    law = stats.ncx2(n, n * rms**2 / u**2)
    assert measured.probability == pytest.approx(law.cdf(n * off**2 / u**2), abs=1e-6)
    p = section.parameters["arm1"]
    law = stats.norm(p.value - p.nominal, p.sd)
    assert arm.probability == pytest.approx(law.cdf(0.5) - law.cdf(-0.5), abs=1e-9)
    # without a tolerance, that which the acceptance test promised
    promised = [
        e.tolerance for e in certified(folder, "").conformity if "z" in e.quantity
    ]
    assert promised == pytest.approx([1e-6 * acceptance.components["z"].promised] * 2)


def test_verdicts_follow_the_stated_rule(folder, oed):
    """A prediction conforms where an acceptance test confirms it, and never alone."""
    tolerance = "z_um = 1e6\nx_um = 0.001\n"
    assert certified(folder, tolerance).verdicts == ["cannot tell", "fail"]
    with_acceptance(folder, oed)
    verdicts = certified(folder, tolerance).verdicts
    assert verdicts[:2] == ["pass", "pass"]
    state(folder, "z_um = 1000.0\n", HEAD.replace("decision = 0.95\n", ""))
    assert set(build.certify_folder(folder)[0].verdicts) == {None}


def test_what_is_not_stated_is_asked_for(folder, oed):
    code, _, error = oed("certificate", folder)
    assert code == 2
    assert "certificate.toml" in error
    template = (folder / "certificate.toml").read_text("utf-8")
    assert not (folder / "certificate.xml").exists()
    code, _, error = oed("certificate", folder)
    assert (code, "identifier" in error, "fill it in" in error) == (2, True, True)
    assert (folder / "certificate.toml").read_text("utf-8") == template
    for old, new, field in (
        ('serial = "0815"', 'serial = " "', "item.serial"),
        ('name = "N. N."', 'name = ""', "person[1].name"),
        ('city = "Ulm"', "", "laboratory.city"),
        ('country = "CH"', 'country = "Switzerland"', "customer.country"),
        ('end = "2026-03-02"', 'end = "2026-02-28"', "end"),
        ('begin = "2026-03-01"', 'begin = "1. 3. 26"', "begin"),
        ('country = "CH"', 'country = "Switzerland"', "two capitals, such as DE"),
        ('city = "Ulm"', 'city = "\\u0007"', "no certificate can hold"),
        ("temperature_C = 20.5", "temperature_C = 293.65", "temperature_C"),
    ):
        state(folder, head=HEAD.replace(old, new))
        code, _, error = oed("certificate", folder)
        assert (code, field in error) == (2, True), error
    state(folder, "beta_um = 3.0\n")
    code, _, error = oed("certificate", folder)
    assert (code, "tolerance.beta_um" in error) == (2, True), error
    nowhere = folder / "nowhere" / "head.toml"
    code, _, error = oed("certificate", folder, "--head", nowhere)
    assert (code, "no such certificate file" in error) == (2, True), error
    assert not nowhere.parent.exists()


def test_warnings_of_the_fit_are_stated(folder):
    result = stored(folder)
    section = msgspec.structs.replace(result.estimate, warnings=["Something is odd."])
    result = msgspec.structs.replace(result, estimate=section)
    (folder / "result.json").write_bytes(msgspec.json.encode(result))
    assert certified(folder, "").conditions[-1] == "Something is odd."
    assert "Something is odd." in (folder / "certificate.xml").read_text("utf-8")


def test_a_virtual_machine_gets_none(folder, oed):
    result = stored(folder)
    section = result.estimate
    p = msgspec.structs.replace(section.parameters["arm1"], truth=345.0)
    parameters = {**section.parameters, "arm1": p}
    section = msgspec.structs.replace(section, parameters=parameters)
    result = msgspec.structs.replace(result, estimate=section)
    (folder / "result.json").write_bytes(msgspec.json.encode(result))
    state(folder)
    code, _, error = oed("certificate", folder)
    assert (code, "simulated" in error) == (2, True)


def test_without_a_correction_the_accuracy_is_over_all_answers():
    """As the acceptance test promises it: the compensation sent holds no effects."""
    result = report_fixture.result_of(whole())
    sent_alone = msgspec.structs.replace(result, corrected=None)
    assert build.OVER_ANSWERS in build.conditions(sent_alone)
    assert build.OVER_ANSWERS not in build.conditions(result)
