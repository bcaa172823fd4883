"""The gap between model and machine: what causes it, where it is, how far it shrinks,
what to do about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Items,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_column,
)
from pkm_reports.figures.gap import causes as gap_causes
from pkm_reports.figures.gap import map as gap_map
from pkm_reports.figures.gap import polar as gap_polar
from pkm_reports.figures.gap import trace as gap_trace

ANCHOR: Final = "gap"
TITLE: Final = "The gap: causes, place, remedy"
Part = Mapping[str, Any]
PLACES: Final = 8
#: share by which what two legs explain may differ where nothing tells them apart
SAME: Final = 1e-6
#: share closed beyond which the interval's end is not told in figures
FAR: Final = 1.5
ANSWERS: Final = 6
COEFFICIENTS: Final = 12
SPLITS: Final = {"within": "stretches of runs", "whole": "whole runs"}
LARGER: Final = 1e-9
#: members from which on a class is counted, not led by one of its names
MANY: Final = 6


def blocks(result: Part) -> list[Block]:
    """Findings, causes, traces, circles, map, place, closure, what cannot be told, what
    to do.
    """
    gap: Part = result["gap"]
    made: list[Block] = [
        Items(
            [words.pretty(words.sentence(w)) for w in gap.get("words") or []],
            numbered=True,
        )
    ]
    made += _next(gap)
    made.append(Picture("gap_causes", lambda: gap_causes.draw(gap), _causes(gap)))
    made += _answers(gap) + _sizes(gap) + _places(gap) + _closure(gap)
    made += _noise(gap) + _pictures(gap)
    return made + _confusable(gap) + _untested(gap) + _coefficients(gap)


def present(result: Part) -> bool:
    """Whether there is a diagnosis."""
    return bool(result.get("gap"))


def _next(gap: Part) -> list[Block]:
    said = [words.pretty(words.sentence(text)) for text in gap.get("next") or []]
    return [Paragraph("What to do next:"), Items(said)] if said else []


def _causes(gap: Part) -> str:
    testable = len(gap.get("tried") or []) - len(gap.get("not_testable") or [])
    text = (
        "How probable it is that each effect acts in these readings, after calibration"
        " took what it can explain. "
    )
    text += (
        f"{words.count(testable, 'effect')} of {len(gap.get('tried') or [])} could be"
        " tested"
    )
    more = len(gap.get("marginal") or {}) - len(gap_causes.shown(gap))
    if any(
        len(c) > 1
        for a in (gap.get("answers") or [])[:1]
        for c in a.get("classes") or []
    ):
        text += "; those in light blue cannot be told from those in blue"
    return (
        f"{text}; the {more} least probable are not shown." if more > 0 else f"{text}."
    )


def _answers(gap: Part) -> list[Block]:
    found = gap.get("answers") or []
    if not found:
        return []
    columns = [
        TableColumn("Explanation", wide=True),
        TableColumn("Probability", number=True),
    ]
    columns.append(TableColumn("Cannot be told from", wide=True))
    caption = (
        "Explanations of the gap. What acts beside a named effect and could be any of"
        " many is told as unknown."
    )
    made: list[Block] = [Table(columns, [_row(a) for a in found[:ANSWERS]], caption)]
    kept = gap.get("set95") or []
    if len(kept) > 1:
        caption = (
            "With 95 % probability one of these sets of effects acts, whatever"
            " remainder of unknown form may be beside it (told where it is likelier"
            " than not); an effect, or one that cannot be told from it."
        )
        made.append(Table(columns, [_row(a) for a in kept], caption))
    return made


def _row(answer: Part) -> list[Any]:
    others = [
        [n for n in c if n not in answer["effects"] or len(c) >= MANY]
        for c in answer.get("classes") or []
    ]
    alike = words.listing(
        gap_causes.spoken(n) for n in dict.fromkeys(n for c in others for n in c)
    )
    return [_told(answer), words.percent(answer["probability"]), alike or words.MISSING]


def _told(answer: Part) -> str:
    """The effects of an answer; one of many is not named before the others."""
    counts = {c[0]: len(c) for c in answer.get("classes") or [] if len(c) >= MANY}
    names = [
        (
            "an effect of unknown form"
            if n == "unknown"
            else f"one of {counts[n]}"
            if n in counts
            else gap_causes.spoken(n)
        )
        for n in answer["effects"]
    ]
    return words.listing(names) or "no gap: noise alone"


def _sizes(gap: Part) -> list[Block]:
    sizes, units, constants = (
        gap.get("sizes") or [],
        gap.get("units") or {},
        gap.get("constants") or {},
    )
    rows = [
        [
            gap_causes.spoken(str(s["effect"])),
            str((gap.get("about") or {}).get(s["effect"], {}).get("about", ""))
            + _constants(constants.get(s["effect"])),
            words.listing(
                _channel(n, v, units)
                for n, v in (s.get("rms") or {}).items()
                if words.number(v) > LARGER
            ),
            words.num(s.get("detectability")),
        ]
        for s in sizes
    ]
    if not rows:
        return []
    columns = [
        TableColumn("Effect"),
        TableColumn("What it is", wide=True),
        TableColumn("Size, rms", number=True),
    ]
    columns.append(TableColumn("Detectability", number=True))
    caption = (
        "Effects found, with their size in the readings. Detectability: what"
        " calibration leaves of the effect, as a multiple of the noise over all"
        " readings together; below about 5 an effect is hard to see. In brackets: what"
        " its form depends on, at the likeliest value, in SI units."
    )
    return [Table(columns, rows, caption)]


def _constants(values: Mapping[str, Any] | None) -> str:
    """What the form depends on, as the effect's file defines it, SI."""
    told = ", ".join(
        f"{name} = {words.num(value)}" for name, value in (values or {}).items()
    )
    return f" ({told})" if told else ""


def _channel(name: str, value: Any, units: Mapping[str, Any]) -> str:
    told = words.quantity(value, str(units.get(name, "")))
    return told if len(units) == 1 else f"{name} {told}"


def _coefficients(gap: Part) -> list[Block]:
    found = sorted(
        gap.get("coefficients") or [], key=lambda c: -abs(_in_sizes(c, "value"))
    )
    rows = [
        [
            gap_causes.spoken(str(c["effect"])),
            str(c["name"]),
            words.num(c["value"]),
            words.num(c["sd"], 2),
            (
                f"{words.fixed(_in_sizes(c, 'value'), 2)} ±"
                f" {words.fixed(_in_sizes(c, 'sd'), 2)}"
            ),
        ]
        for c in found[:COEFFICIENTS]
    ]
    if not rows:
        return []
    titles = ("Value [SI]", "Sd [SI]", "In expected sizes")
    columns = [
        TableColumn("Effect"),
        TableColumn("Coefficient", wide=True),
        *number_column(*titles),
    ]
    caption = (
        "Coefficients of the effects found, in SI units and in units of the size that"
        " was expected of each"
    )
    cut = (
        f"; the {len(rows)} largest of {len(found)}." if len(found) > len(rows) else "."
    )
    return [Table(columns, rows, caption + cut)]


def _in_sizes(coefficient: Part, key: str) -> float:
    """A coefficient (or its sd) over the size expected of it; NaN where that is not
    known.
    """
    size = words.number(coefficient.get("prior_sd"))
    return words.number(coefficient[key]) / size if size > 0.0 else float("nan")


def _pictures(gap: Part) -> list[Block]:
    traces: Sequence[Part] = gap.get("traces") or []
    if not traces:
        return []
    made: list[Block] = [
        Picture("gap_trace", lambda: gap_trace.draw(traces), _trace_caption(traces))
    ]
    if gap_polar.circles(traces):
        made.append(
            Picture("gap_polar", lambda: gap_polar.draw(traces), _polar_caption(traces))
        )
    spots = gap.get("spots") or []
    if spots:
        unit = str(gap.get("spots_unit") or "um")
        text = "Residual by place of the tool"
        text += (
            ", before and after the found effects are in the model, with one scale. "
            if _explained(traces)
            else ". "
        )
        text += (
            f"{words.count(len(spots), 'place')}; readings at one place are taken"
            " together."
        )
        made.append(Picture("gap_map", lambda: gap_map.draw(spots, unit), text))
    return made


def _trace_caption(traces: Sequence[Part]) -> str:
    shown = len(gap_trace.chosen(traces))
    text = "Residual of each run: grey what calibration leaves"
    if _explained(traces):
        text += (
            ", orange what the found effects explain of it, blue what is left with them"
            " in the model"
        )
    if any(words.number(v) != 0.0 for t in traces for v in t.get("unexplained") or []):
        text += ", pink what has a form that no known effect has"
    text += ". "
    what = "run" if len({t["channel"] for t in traces}) == 1 else "trace"
    if shown < len(traces):
        return (
            f"{text}Shown are the {shown} of {words.count(len(traces), what)} with the"
            " largest residuals before."
        )
    return f"{text}{words.count(shown, what)}."


def _explained(traces: Sequence[Part]) -> bool:
    """Whether found effects explain anything."""
    return any(words.number(v) != 0.0 for t in traces for v in t.get("explained") or [])


def _polar_caption(traces: Sequence[Part]) -> str:
    kept = gap_polar.circles(traces)
    every = len(
        {
            (t["setup"], t["base"], t["channel"], t.get("payload_N"))
            for t in traces
            if t["kind"] == "circle"
        }
    )
    how = ", alike above and below" if _explained(traces) else ""
    text = "Circles as a ball bar draws them" + (
        ", above before and below after" if how else ""
    )
    text += (
        f": the residual is magnified about the thin circle{how}; the bar tells its"
        " scale. "
    )
    if len(kept) < every:
        return (
            f"{text}Shown are the {len(kept)} of {every} circles with the largest"
            " residuals."
        )
    return f"{text}{words.count(every, 'circle')}."


def _places(gap: Part) -> list[Block]:
    found = (gap.get("where") or [])[:PLACES]
    if not found or gap["verdict"] == "none":
        return []
    rows = [
        [_place(str(w["block"])), _p(w["p_value"]), words.percent(w.get("strength"))]
        for w in found
    ]
    columns = [
        TableColumn("Where", wide=True),
        *number_column("p-value", "Share of the gap"),
    ]
    caption = (
        "Where the gap shows, first what confines it best: the chance (p-value,"
        " corrected for the number of places looked at) that noise alone would stand"
        " out as much there, and the share of the gap that lies there. One gap shows in"
        " several places at once."
    )
    alike = _tied(found)
    if alike:
        caption += (
            f" Of {' and '.join(alike)} the readings are the same, so that nothing"
            " tells which of them it is."
        )
    marks = ["chosen" if words.number(w["p_value"]) < 0.05 else "" for w in found]
    return [Table(columns, rows, caption, marks)]


def _tied(found: Sequence[Part]) -> list[str]:
    """The legs that explain exactly as much as the first one told does, where that is
    much.
    """
    legs = [
        w
        for w in found
        if str(w["block"]).startswith("leg ") and words.number(w["p_value"]) < 0.05
    ]
    size = words.number(legs[0].get("strength")) if legs else 0.0
    same = [
        str(w["block"])
        for w in legs
        if abs(words.number(w.get("strength")) - size) < SAME * size
    ]
    return same if len(same) > 1 else []


def _place(block: str) -> str:
    kind, _, rest = block.partition(" ")
    return {"time": f"time {rest} s", "phase": f"part of each run, {rest}°"}.get(
        kind, block
    )


def _p(value: Any) -> str:
    return "< 0.001" if words.number(value) < 1e-3 else words.num(value, 2)


def _closure(gap: Part) -> list[Block]:
    rows = [
        [
            SPLITS.get(str(c["split"]), str(c["split"])),
            str(c["n"]),
            _share(c.get("value")),
            _interval(c),
            words.percent(c.get("p_worse")),
            *(words.num(c.get(k)) for k in ("s0", "s1", "s_noise")),
        ]
        for c in gap.get("closure") or []
    ]
    if not rows:
        return []
    titles = (
        "Readings",
        "Gap closed",
        "95 % interval",
        "Chance of harm",
        "Before",
        "After",
        "Noise alone",
    )
    caption = (
        "How far the gap shrinks on readings that were kept out of the fit. Before,"
        " after and noise alone are mean squared residuals in units of what is expected"
        " of them; the gap closed is (before − after) / (before − noise alone). Whole"
        " unseen runs also show what the geometry could not learn from the others."
    )
    return [
        Table(
            [TableColumn("Kept out", wide=True), *number_column(*titles)], rows, caption
        )
    ]


def _interval(closure: Part) -> str:
    low, high = closure.get("low"), closure.get("high")
    return (
        words.MISSING if low is None or high is None else f"{_end(low)} to {_end(high)}"
    )


def _end(value: Any) -> str:
    """An end of an interval; far off what a share can be it says no more than that."""
    if words.number(value) > FAR:
        return f"over 100{words.GAP}%"
    return f"under -100{words.GAP}%" if words.number(value) < -1.0 else _share(value)


def _share(value: Any) -> str:
    """A share in percent, never rounded up to the whole."""
    return (
        words.certain(value)
        if 0.99 < words.number(value) < 1.0
        else words.percent(value)
    )


def _confusable(gap: Part) -> list[Block]:
    groups = [g for g in gap.get("confusable") or [] if len(g) > 1]
    if not groups:
        return []
    about = gap.get("about") or {}
    told = []
    for group in groups:
        ways = [
            str(about[n]["exposed_by"])
            for n in group
            if n in about and about[n].get("exposed_by")
        ]
        ways = list(dict.fromkeys(ways))
        tail = f"; what tells them apart: {'; '.join(ways)}" if ways else ""
        told.append(
            words.sentence(words.listing(gap_causes.spoken(n) for n in group) + tail)
        )
    return [
        Paragraph(
            "These readings cannot tell the effects of a group from one another:"
        ),
        Items(told),
    ]


def _untested(gap: Part) -> list[Block]:
    about = gap.get("about") or {}
    rows = []
    for name in gap.get("not_testable") or []:
        one = about.get(name, {})
        record = str(one.get("column") or "") or words.MISSING
        rows.append(
            [gap_causes.spoken(str(name)), str(one.get("missing") or ""), record]
        )
    if not rows:
        return []
    columns = [
        TableColumn("Effect"),
        TableColumn("Why not", wide=True),
        TableColumn("Record in the readings", wide=True),
    ]
    return [
        Table(
            columns,
            rows,
            "Effects that these readings cannot test; where a column is wanting, they"
            " may act all the same.",
        )
    ]


def _noise(gap: Part) -> list[Block]:
    said = [words.sentence(text) for text in gap.get("noise") or []]
    before, after, units = (
        gap.get("rms_before") or {},
        gap.get("rms_after") or {},
        gap.get("units") or {},
    )
    changed = after != before
    parts = []
    for n, v in before.items():
        told = words.quantity(v, str(units.get(n, "")))
        last = words.quantity(after.get(n), str(units.get(n, "")))
        parts.append(f"{n} from {told} to {last}" if changed else f"{n} {told}")
    rms = (
        f"The rms residual of all readings {'falls, in' if changed else 'is, in'}"
        f" {words.listing(parts)}."
    )
    rms = rms if parts else ""
    text = " ".join([rms, *said]).strip()
    return [Paragraph(text)] if text else []
