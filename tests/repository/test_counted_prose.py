"""Numbers in prose that the code can count."""

import re
import statistics
from pathlib import Path
from typing import Any

import pytest

from pkm_studies.catalogue import listing
from pkm_studies.study import SCHEMAS

ROOT = Path(__file__).resolve().parents[2]
#: share by which a round number of lines may differ from the median of the files
ROUNDED = 0.1


def stated(pattern: str, path: str) -> int:
    """The only number of a pattern in a text, lines joined."""
    text = " ".join((ROOT / path).read_text(encoding="utf-8").split())
    (number,) = re.findall(pattern, text)
    return int(number)


def median_length(kind: str) -> float:
    """Median number of lines of the files that define what the catalogue lists."""
    files = (ROOT / "models" / "pkm_models" / kind).glob("*.py")
    texts = [file.read_text(encoding="utf-8") for file in files]
    named = [t for t in texts if re.search(r"^(machine|family|effect)\b", t, re.M)]
    return statistics.median(text.count("\n") for text in named)


def test_the_readme_counts_the_effects():
    assert stated(r"(\d+) physical effects", "README.md") == len(listing("effects"))


@pytest.mark.parametrize(("kind", "path", "pattern"), [
    ("machines", "README.md", r"machine is one file of about (\d+) lines"),
    ("machines", "CONTRIBUTING.md", r"file of about (\d+) lines in"),
    ("machines", "docs/reference/architecture.md", r"machine is one file of about (\d+) lines"),
    ("effects", "README.md", r"new effect one of about (\d+)"),
    ("effects", "CONTRIBUTING.md", r"effects/` of about (\d+) lines"),
    ("effects", "docs/howto/diagnose.md", r"a file of about (\d+) lines"),
])  # fmt: skip
def test_lengths_of_files_are_stated_as_they_are(kind, path, pattern):
    assert stated(pattern, path) == pytest.approx(median_length(kind), rel=ROUNDED)


def test_each_field_of_a_study_has_its_meaning_in_the_schema():
    tables: dict[str, Any] = SCHEMAS["study"]()["$defs"]
    fields = [
        (table, name, field.get("description"))
        for table, definition in tables.items()
        for name, field in definition.get("properties", {}).items()
    ]
    assert len(fields) > 280
    assert not [(table, name) for table, name, meaning in fields if not meaning]
    meaning = tables["ReferenceTable"]["properties"]["runs_by"]["description"]
    assert meaning == "coordinate of which each value makes one run"


def test_records_of_results_say_what_their_fields_mean():
    """Fields whose name says it have no line of their own."""
    tables: dict[str, Any] = SCHEMAS["result"]()["$defs"]
    fields = [
        f for table in tables.values() for f in table.get("properties", {}).values()
    ]
    assert sum("description" in field for field in fields) > 223
