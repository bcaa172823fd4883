"""Reads `certificate.toml`: what no calibration knows of laboratory, machine and customer."""

import datetime
import re
from collections.abc import Iterator
from pathlib import Path

import msgspec

from pkm_certificate.statement import CertificateHead
from pkm_studies import files
from pkm_studies.base import Location
from pkm_studies.study import decode_table, tables_of

FILE = "certificate.toml"
MAX_BYTES = 1_000_000
#: what XML cannot hold
CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")

TEMPLATE = """\
# What the calibration cannot know. Fill in each empty text, and call `oed certificate`
# again. Lines that begin with # are optional: remove the # to state them.

identifier = ""          # of this certificate, unique
country = ""             # of issue, two letters of ISO 3166-1
begin = ""               # first day of the readings, as in 2026-03-01
end = ""                 # last day of the readings
place = "laboratory"     # laboratory, customer, laboratoryBranch, customerBranch, other
# temperature_C = 20.0   # during the readings
# issued = "2026-03-02"
# decision = 0.95        # state conformity where its probability is at least this

[item]
serial = ""              # number of the machine
# manufacturer = ""
# model = ""

[laboratory]
name = ""
city = ""
country = ""
# street = ""
# post_code = ""
# email = ""
# accreditation = ""     # registration of the accreditation, where there is one

[customer]
name = ""
city = ""
country = ""

[[person]]
name = ""
# role = ""
# signs = true

# [[instrument]]
# name = ""
# serial = ""
# certificate = ""       # number of its own certificate

# Largest allowed rms error of a pose component after compensation, or largest departure
# of a parameter from nominal: the unit is in the name.
[tolerance]
"""


def read(path: Path) -> CertificateHead:
    """The head; an absent file is made. Raises InputError."""
    location = Location(str(path))
    if not path.exists() and path.parent.is_dir():
        files.write_whole(path, TEMPLATE)
        raise location.error(
            "a certificate states what no calibration knows: laboratory, customer,"
            " dates, serial number. This file is written with empty texts",
            "fill them in, and call the command again",
        )
    text = files.read_text(path, limit=MAX_BYTES, what="certificate file")
    table = tables_of(text, location)
    file = decode_table(CertificateHead, table, location)
    _check(file, location)
    return file


def _check(file: CertificateHead, location: Location) -> None:
    """Raises InputError for a needed text that is empty, and for dates that are none."""
    if not file.person:
        raise location.key("person").error("missing", "add a [[person]] with a name")
    for field_location, table in _tables(file, location):
        for field in msgspec.structs.fields(table):
            value = getattr(table, field.name)
            if isinstance(value, str) and CONTROL.search(value):
                raise field_location.key(field.encode_name).error(
                    "a character that no certificate can hold", "remove it", value
                )
            if field.required and isinstance(value, str) and not value.strip():
                raise field_location.key(field.encode_name).error(
                    "empty", "a certificate has to state it: fill it in"
                )
    dates = [_date(getattr(file, key), location.key(key)) for key in ("begin", "end")]
    if file.issued:
        dates.append(_date(file.issued, location.key("issued")))
    if dates != sorted(dates):
        raise location.key("end").error(
            "begin, end and issued are not in this order", "correct the dates", file.end
        )


def _tables(
    file: CertificateHead, location: Location
) -> Iterator[tuple[Location, msgspec.Struct]]:
    yield location, file
    for key in ("item", "laboratory", "customer"):
        yield location.key(key), getattr(file, key)
    for key in ("person", "instrument"):
        for i, table in enumerate(getattr(file, key)):
            yield location.path(key, i), table


def _date(text: str, location: Location) -> datetime.date:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        raise location.error("no date", "write it as in 2026-03-01", text) from None
