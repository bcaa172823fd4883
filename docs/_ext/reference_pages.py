"""Pages of the reference that the command `oed` writes: study and result fields, catalogue.

`oed schema` and `oed list` are the source, so the pages agree with what the program
accepts. The pages are written into `reference/generated` before Sphinx reads.
"""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import plain_docstrings
from sphinx.application import Sphinx

FOLDER = Path("reference", "generated")
#: how a description names its table: [design], [[setup]]
TABLE = re.compile(r"(\[\[?[\w.]+\]\]?)")
KINDS = ("machines", "instruments", "effects", "criteria")
#: columns of effects beside those of all kinds
OF_EFFECTS = ["needs", "what shows it"]


def answer(*arguments: str) -> Any:
    """What the command prints, decoded from JSON."""
    command = [str(Path(sys.executable).with_name("oed")), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def heading(text: str, mark: str) -> list[str]:
    """A heading of reStructuredText."""
    return [text, mark * len(text), ""]


def cell_table(header: list[str], rows: list[list[str]]) -> list[str]:
    """A list table."""
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for row in [header, *rows]:
        lines += [
            f"   {'* -' if k == 0 else '  -'} {text}" for k, text in enumerate(row)
        ]
    return [*lines, ""]


def kind_of(field: dict[str, Any]) -> str:
    """The type of a field, in short."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f":ref:`{name}`"
    if "anyOf" in field:
        kinds = [kind_of(f) for f in field["anyOf"] if f.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "enum" in field:
        return ", ".join(f"``{json.dumps(value)}``" for value in field["enum"])
    if field.get("type") == "array" and isinstance(field.get("items"), dict):
        return f"list of {kind_of(field['items'])}"
    return str(field.get("type", "any"))


def default_of(name: str, field: dict[str, Any], required: list[str]) -> str:
    """The default of a field, in short."""
    if name in required:
        return "required"
    value = field.get("default")
    if value is None or value == [] or isinstance(value, dict):
        return ""
    return f"``{json.dumps(value)}``"


def section(name: str, entry: dict[str, Any]) -> list[str]:
    """One table of a file: its text, and its fields with type, default and meaning."""
    first, *others = entry.get("description", "").splitlines() or [""]
    text = [first, *[line.removeprefix("    ") for line in others]]
    table = TABLE.match(first)
    lines = [f".. _{name}:", "", *heading(table.group(1) if table else name, "-")]
    meanings = plain_docstrings.fields(text)
    properties = entry.get("properties", {})
    lines += plain_docstrings.restructured(without_fields(text))
    rows = []
    for field, about in properties.items():
        default = default_of(field, about, entry.get("required", []))
        meaning = plain_docstrings.inline(about.get("description", ""))
        rows.append([f"``{field}``", kind_of(about), default, meaning])
    for field in sorted(meanings.keys() - properties.keys()):
        rows.append([field, "", "", plain_docstrings.inline(meanings[field])])
    return [*lines, *cell_table(["field", "type", "default", "meaning"], rows)]


def without_fields(text: list[str]) -> list[str]:
    """A description without its list of fields."""
    lines: list[str] = []
    for block in plain_docstrings.blocks(text):
        for kind, members in plain_docstrings.parts(block):
            if kind != "fields":
                lines += [*members, ""]
    return lines


def schema_page(kind: str, title: str, first: str) -> str:
    """Fields of a file, one section a table."""
    lines = [*heading(title, "="), first, ""]
    for name, entry in answer("schema", kind)["$defs"].items():
        lines += section(name, entry)
    return "\n".join(lines)


def catalogue_page() -> str:
    """Machines, instruments, effects and criteria with their sources."""
    lines = [*heading("Catalogue", "="), "What ``oed list`` prints, with sources.", ""]
    for kind in KINDS:
        further = OF_EFFECTS if kind == "effects" else []
        rows = []
        for entry in answer("list", kind, "--json"):
            texts = [entry["about"], *further_cells(entry, further), entry["source"]]
            cells = [plain_docstrings.inline(text) for text in texts]
            rows.append([f"``{entry['name']}``", *cells])
        lines += heading(kind.capitalize(), "-")
        header = ["name", "what it is", *further, "source"]
        lines += cell_table(header, rows)
    return "\n".join([*lines, *column_tables()])


def further_cells(entry: dict[str, Any], further: list[str]) -> list[str]:
    """What the readings must record, and the readings that show it; for effects."""
    if not further:
        return []
    module, _, name = entry["where"].partition(":")
    effect = getattr(importlib.import_module(module), name)
    return [", ".join(effect.needs), effect.exposed_by]


def column_tables() -> list[str]:
    """Frames and columns of every machine and instrument."""
    lines = heading("Frames and columns", "-")
    lines += [
        "Frame, order, sense and usual unit of every coordinate, channel and parameter. Matrices"
        " take vectors of the platform's frame into the stated one.",
        "",
    ]
    for kind in ("machines", "instruments"):
        for entry in answer("list", kind, "--json"):
            lines += heading(f"``{entry['name']}``", "~")
            for sentence in entry["frames"]:
                lines += [f"- {plain_docstrings.inline(sentence)}"]
            rows = [
                [f"``{c['name']}``", c["role"], plain_docstrings.inline(c["about"])]
                for c in entry["columns"]
            ]
            lines += ["", *cell_table(["column", "role", "what it is"], rows)]
    return lines


def generate(app: Sphinx) -> None:
    """Write the pages; unchanged ones keep their time."""
    pages = {
        "study": schema_page(
            "study",
            "Study fields",
            "Tables and fields of ``*.study.toml``, as ``oed schema study`` states them.",
        ),
        "result": schema_page(
            "result",
            "Result fields",
            "Sections and fields of ``result.json``, as ``oed schema result`` states them.",
        ),
        "catalogue": catalogue_page(),
    }
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Generate before the sources are read."""
    app.connect("builder-inited", generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
