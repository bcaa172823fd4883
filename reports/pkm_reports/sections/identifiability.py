"""What the readings can see: singular values, the verdict in words, variants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    absent,
    number_column,
    transposed,
)
from pkm_reports.figures import singular

ANCHOR: Final = "identifiability"
TITLE: Final = "What the readings can see"
Part = Mapping[str, Any]
#: lost directions of a variant beyond which they are counted, not described
MANY = 8
VERDICTS: Final = {
    "seen": ("seen", "good"),
    "combination": ("only in combination", ""),
    "weak": ("weakly seen", "chosen"),
    "lost": ("lost", "bad"),
}


def blocks(result: Part) -> list[Block]:
    """Singular values and words for the plan, then the variants asked for."""
    part, variants = (
        result.get("identifiability"),
        result.get("identifiability_of") or {},
    )
    made = _whole(part) if part else absent("An analysis of what the readings can see")
    return made + ([_variants(variants, part)] if variants else [])


def _whole(part: Part) -> list[Block]:
    made: list[Block] = [
        Paragraph(_verdict(part)),
        Picture("singular", lambda: singular.draw(part), _caption(part)),
    ]
    if part.get("words"):
        made.append(_words(part["words"]))
    made += _directions(
        "Seen only in combination",
        _mixed(part.get("combinations") or []),
        "combination",
    )
    return made + _directions("Lost directions", part.get("lost") or [], "direction")


def _verdict(part: Part) -> str:
    lost = part["n"] - part["rank"]
    text = (
        f"The readings see {part['rank']} of"
        f" {words.count(part['n'], 'parameter direction')}"
    )
    if not lost:
        return f"{text}: nothing is lost. Scaling: {part['scaling']}."
    one = (
        "1 direction is lost and keeps its"
        if lost == 1
        else f"{lost} directions are lost and keep their"
    )
    return f"{text}; {one} tolerance. Scaling: {part['scaling']}."


def condition(part: Part) -> float:
    """Largest over smallest non-zero singular value."""
    seen = [words.number(v) for v in part["singular_values"][: part["rank"]]]
    return seen[0] / seen[-1] if seen and seen[-1] > 0.0 else float("nan")


def _caption(part: Part) -> str:
    values, rank = [words.number(v) for v in part["singular_values"]], part["rank"]
    if not rank:
        return (
            "Singular values of the scaled identification matrix: none stands above the"
            " tolerance."
        )
    text = (
        f"Singular values of the scaled identification matrix: {words.num(values[0])}"
        f" down to {words.num(values[rank - 1])} over the {rank} seen directions"
        f" (condition number {words.num(condition(part), 4)})."
    )
    if part["n"] == rank:
        return f"{text} All stand above the tolerance (dashed)."
    lost = values[rank:] or [0.0]
    gap = (
        f"the largest is {words.num(max(lost), 2)} before it is set to zero"
        if max(lost) > 0
        else "exactly zero"
    )
    rest = part["n"] - rank
    other = "The other one lies" if rest == 1 else f"The other {rest} lie"
    return f"{text} {other} below the tolerance (dashed): {gap}."


def _words(groups: Sequence[Part]) -> Table:
    rows = [
        [
            VERDICTS.get(g["kind"], (str(g["kind"]), ""))[0],
            words.sentence(g["text"]),
            "; ".join(str(r) for r in g.get("remedies") or []) or words.MISSING,
        ]
        for g in groups
    ]
    columns = [
        TableColumn("Verdict"),
        TableColumn("What", wide=True),
        TableColumn("What would bring it back", wide=True),
    ]
    kinds = [g["kind"] for g in groups]
    told = [
        f"{kinds.count(k)} {VERDICTS.get(k, (k, ''))[0]}" for k in dict.fromkeys(kinds)
    ]
    marks = [VERDICTS.get(kind, ("", ""))[1] for kind in kinds]
    return Table(
        columns,
        rows,
        f"Identifiability in words, by groups of parameters: {words.listing(told)}.",
        marks,
    )


def _directions(
    title: str, vectors: Sequence[Mapping[str, float]], noun: str
) -> list[Block]:
    if not vectors:
        return []
    rows = [[str(k + 1), words.combination(dict(v))] for k, v in enumerate(vectors)]
    columns = [
        TableColumn(noun.capitalize(), number=True),
        TableColumn("Coefficients of the parameters (SI units)", wide=True),
    ]
    return [
        Table(
            columns,
            rows,
            f"{title}: {words.count(len(vectors), noun)}, the largest terms first.",
        )
    ]


def _mixed(vectors: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Combinations of at least two parameters; a parameter seen alone is told in the
    words.
    """
    return [v for v in vectors if len(v) > 1]


def _variants(variants: Mapping[str, Part], part: Part | None) -> Table:
    entries = {**({"this plan": part} if part else {}), **variants}
    cells = [
        list(entries),
        [f"{v['rank']} of {v['n']}" for v in entries.values()],
        [str(v["n"] - v["rank"]) for v in entries.values()],
        [words.num(condition(v), 4) for v in entries.values()],
        [_lost(v) for v in entries.values()],
    ]
    columns = [
        TableColumn("Variant"),
        *number_column("Rank", "Lost", "κ"),
        TableColumn("What is lost", wide=True),
    ]
    best = max(variants.items(), key=lambda item: item[1]["rank"] - item[1]["n"])
    lost = best[1]["n"] - best[1]["rank"]
    caption = (
        f"What other arrangements would see. “{best[0]}” loses least:"
        f" {words.count(lost, 'direction')}."
    )
    return Table(
        columns,
        transposed(cells),
        caption,
        ["chosen" if part and k == 0 else "" for k in range(len(entries))],
    )


def _lost(part: Part) -> str:
    """What is lost, in words where it has a name; of many directions only how many:
    result.json lists them.
    """
    if part["n"] - part["rank"] > MANY:
        return (
            f"{part['n'] - part['rank']} directions: far too few readings, or too"
            " alike, on their own."
        )
    told = [
        words.sentence(g["text"])
        for g in part.get("words") or []
        if g["kind"] == "lost"
    ]
    if told:
        return " ".join(told)
    return (
        words.MISSING
        if part["n"] == part["rank"]
        else "; ".join(words.combination(dict(v)) for v in part["lost"])
    )
