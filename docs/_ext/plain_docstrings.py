"""Plain-text docstrings as reStructuredText: paragraphs, formulas, lists of fields.

The packages' docstrings are plain text, to be read in an editor. Their forms are

* paragraphs, with code between single backticks;
* lists of fields, one a line: `name    what it is`, continued by indented lines;
* bulleted lists;
* indented lines: formulas and sketches, shown as they stand.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

FIELD = re.compile(r"^(\S(?:.*?\S)?) {2,}(\S.*)$")
BULLET = re.compile(r"^[*-] +(\S.*)$")
CODE = re.compile(r"``[^`]+``|`[^`]+`")
ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
#: an array type that is spelled out, and its alias by the kind of its values
ARRAY = re.compile(
    r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?numpy\.(\w+)\]\]"
)
ARRAY_ALIASES = {"float64": "Array", "int64": "Index", "bool": "Mask"}
SPECIAL = re.compile(r"([\\*|_`])")
#: what would open a list, a comment or a field at a paragraph's start
OPENING = re.compile(r"^([-+>.:]|\(?\w+[.)])(?=\s|\S)")


def restructured(lines: Iterable[str]) -> list[str]:
    """A docstring's lines as reStructuredText."""
    result: list[str] = []
    for block in blocks(lines):
        for kind, members in parts(block):
            result += [*render(kind, members), ""]
    return result


def blocks(lines: Iterable[str]) -> Iterator[list[str]]:
    """Stretches of lines between blank ones."""
    block: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            block.append(line.rstrip())
        elif block:
            yield block
            block = []


def parts(block: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Neighbouring lines of one kind: "text", "fields", "bullets" or "literal"."""
    current, members = "", list[str]()
    for line in aligned(block):
        kind = kind_of(line, current)
        if kind != current and members:
            yield current, members
            members = []
        current = kind
        members.append(line)
    yield current, members


def aligned(block: list[str]) -> list[str]:
    """Lines of a block; a field whose name fills its column gets its second space."""
    matches = [FIELD.match(line) for line in block if not line.startswith(" ")]
    columns = {match.start(2) for match in matches if match}
    if len(columns) != 1:
        return block
    (column,) = columns
    full = re.compile(rf"^\S{{{column - 1}}} \S")
    return [line.replace(" ", "  ", 1) if full.match(line) else line for line in block]


def kind_of(line: str, before: str) -> str:
    """Kind of a line after one of kind `before`."""
    if line.startswith(" "):
        return before if before in ("fields", "bullets") else "literal"
    if BULLET.match(line):
        return "bullets"
    return "fields" if FIELD.match(line) else "text"


def fields(lines: Iterable[str]) -> dict[str, str]:
    """Texts of a docstring's fields by their names; `a, b    text` is of both."""
    texts: dict[str, str] = {}
    for block in blocks(lines):
        for kind, members in parts(block):
            if kind == "fields":
                for names, text in joined(members, FIELD):
                    texts |= {name.strip(): text for name in names.split(",")}
    return texts


def render(kind: str, lines: list[str]) -> list[str]:
    """Lines of one kind as reStructuredText."""
    if kind == "literal":
        return ["::", "", *[f"    {line}" for line in lines]]
    if kind == "text":
        return [opened(inline(" ".join(lines)))]
    if kind == "bullets":
        items = joined(lines, BULLET)
        return [f"* {opened(inline(text))}" for (text,) in items]
    result = [".. rst-class:: fields", ""]
    for name, text in joined(lines, FIELD):
        term = name.replace("`", "")
        result += [f"``{term}``", f"    {opened(inline(text))}"]
    return result


def joined(lines: list[str], pattern: re.Pattern[str]) -> list[tuple[str, ...]]:
    """Groups of each item; its last one is continued by the lines indented below it."""
    items: list[tuple[str, ...]] = []
    for line in lines:
        match = None if line.startswith(" ") else pattern.match(line)
        if match:
            items.append(match.groups())
        else:
            *first, last = items[-1]
            items[-1] = (*first, f"{last} {line.strip()}")
    return items


def inline(text: str) -> str:
    """Text with its code as literals and all other markup escaped."""
    result, end = "", 0
    for match in CODE.finditer(text):
        result += SPECIAL.sub(r"\\\1", text[end : match.start()])
        code = match.group().strip("`")
        follows = text[match.end() : match.end() + 1]
        separator = "\\ " if follows.isalnum() or follows == "_" else ""
        result += f"``{code}``{separator}"
        end = match.end()
    return result + SPECIAL.sub(r"\\\1", text[end:])


def opened(text: str) -> str:
    """Text whose first character opens nothing."""
    return f"\\{text}" if OPENING.match(text) else text


def process(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Rewrite a docstring of the project in place."""
    lines[:] = restructured(lines)


def name_aliases(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: object,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Aliases of types in a signature by their names alone."""
    return tuple(text and with_aliases(text) for text in (signature, returns))


def with_aliases(signature: str) -> str:
    """A signature with the aliases of array types in place of what they stand for."""

    def alias(match: re.Match[str]) -> str:
        return ARRAY_ALIASES.get(match[1], match[0])

    return ARRAY.sub(alias, ALIAS.sub(r"\1", signature))


def unlink_foreign_types(app: Sphinx, document: nodes.document) -> None:
    """Leave types in signatures that are not of the project as plain text.

    There is nothing to link them to, and looking for them takes most of the time.
    """
    for signature in document.findall(addnodes.desc_signature):
        for reference in list(signature.findall(addnodes.pending_xref)):
            if not reference["reftarget"].startswith(("oed.", "pkm_")):
                reference.replace_self(reference.children)


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen to autodoc."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", name_aliases)
    app.connect("doctree-read", unlink_foreign_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
