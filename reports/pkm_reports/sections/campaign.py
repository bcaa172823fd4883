"""Which measurement at which stage: the plan in stages, what each leaves, what no plan
betters, what was not taken.

Only for plans that were searched for: their stages have times (`begin_min`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Items,
    Notice,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_column,
    transposed,
)
from pkm_reports.figures import front, stages, timeline

ANCHOR: Final = "campaign"
TITLE: Final = "Which measurement at which stage"
#: parameters told of each stage, those that improved most
TOLD: Final = 4
#: factor below which a parameter's standard deviation counts as unchanged by a stage
IMPROVED: Final = 1.05
#: signs of a combination that is held, longer ones are cut
LONGEST: Final = 56
Part = Mapping[str, Any]


def planned(result: Part) -> bool:
    """Whether the result holds a plan that was searched for."""
    steps = (result.get("plan") or {}).get("stages") or []
    return any(step.get("begin_min") is not None for step in steps)


def blocks(result: Part) -> list[Block]:
    """Verdict, stages, accuracy and time, what time buys, what was not taken, sequences
    side by side.
    """
    plan = result["plan"]
    pictures = [
        Picture("plan_stages", lambda: stages.draw(plan), _lines(plan)),
        Picture("plan_timeline", lambda: timeline.draw(plan), _times(plan)),
    ]
    return [
        *_verdict(plan),
        _order(plan),
        _identified(plan, result.get("machine") or {}),
        _accuracy(plan),
        *_virtual(plan),
        *pictures,
        Picture("plan_front", lambda: front.draw(plan), _front(plan)),
        *_rejected(plan),
        *_compared(plan),
    ]


# -- the answer in sentences -----------------------------------------------------------


def _verdict(plan: Part) -> list[Block]:
    """Reached or not, what would have to change, how much better another plan could be,
    when to stop.
    """
    made: list[Block] = (
        [Paragraph(f"Known before: {words.sentence(plan['after'])}")]
        if plan.get("after")
        else []
    )
    needs = [words.sentence(str(text)) for text in plan.get("needs") or []]
    if plan.get("goal") and not plan.get("reached", True):
        made.append(Notice(_missed(plan)))
        made += [Paragraph("What would have to change:"), Items(needs)] if needs else []
    else:
        made.append(Paragraph(_reached(plan)))
        made += (
            [Paragraph("What would make it more accurate:"), Items(needs)]
            if needs
            else []
        )
    made += [Paragraph(_loss(plan))] if _loss(plan) else []
    return made + (
        [Paragraph(f"When to stop: {words.sentence(str(plan['stop']))}")]
        if plan.get("stop")
        else []
    )


def _reached(plan: Part) -> str:
    text = (
        f"{words.count(len(plan['stages']), 'stage')} in"
        f" {_minutes(plan['cost'])}{_of_budget(plan)}"
    )
    text += f", at a price of {words.plain(plan['price'])}" if plan.get("price") else ""
    left = _listed(plan.get("accuracy") or {})
    if plan.get("goal"):
        text = (
            f"What is wanted ({_listed(plan['goal'])}) is reached. The least costly"
            f" plan found has {text}"
        )
        return f"{text}. It leaves {left}." if left else f"{text}."
    text = f"The most accurate plan found has {text}"
    return f"{text}. It leaves {left} (rms over the workspace)." if left else f"{text}."


def _missed(plan: Part) -> str:
    text = f"Out of reach{_within(plan)}: {_listed(plan['goal'])}."
    best = _listed(plan.get("best_reachable") or {}, plan["goal"])
    return f"{text} The most accurate plan found leaves {best}." if best else text


def _loss(plan: Part) -> str:
    """How far the plan can be from the best one, by its bound."""
    bound, loss = words.number(plan.get("bound")), words.number(plan.get("loss"))
    if not math.isfinite(bound):
        return ""
    what = (
        "the largest error over what is wanted of it"
        if plan.get("goal")
        else "the share of error left"
    )
    text = f"No plan{_within(plan)} brings {what} below {words.num(bound)}"
    if math.isfinite(loss):
        mine = "the most accurate plan found" if plan.get("goal") else "the plan"
        text += f": {mine} misses the best possible one by {_at_most(loss)}"
    lines = plan.get("lines")
    return (
        f"{text} (proven with {words.count(lines, 'supporting line')})."
        if lines
        else f"{text}."
    )


def _cut(combination: str) -> str:
    """A combination of parameters, a long one without its last terms."""
    if len(combination) <= LONGEST:
        return combination
    whole = combination[: LONGEST + 1]
    return (
        f"{whole[: max(whole.rfind(' + '), whole.rfind(' - '))]} …"
        if " " in whole
        else words.cut(whole, LONGEST)
    )


def _at_most(loss: float) -> str:
    """A guaranteed loss, never rounded down: one decimal of a percent, or from the
    double on a factor.
    """
    if loss >= 1.0:
        return (
            "at most a factor of"
            f" {words.fixed(math.ceil(10.0 * (1.0 + loss) - 1e-9) / 10.0, 1)}"
        )
    return (
        f"at most {words.fixed(math.ceil(1000.0 * loss - 1e-9) / 10.0, 1)}{words.GAP}%"
    )


def _virtual(plan: Part) -> list[Block]:
    """What virtual machines made of the stages."""
    steps = plan["stages"]
    ratios = [
        words.number(v) for s in steps for v in (s.get("realised") or {}).values()
    ]
    known = [v for v in ratios if math.isfinite(v)]
    if not known:
        return []
    count = plan.get("virtual_machines") or 0
    who = words.count(count, "virtual machine") if count else "Virtual machines"
    text = (
        f"{who} went through all stages: they realised {words.num(min(known))} to"
        f" {words.num(max(known))} of the "
    )
    text += "predicted errors"
    held = [
        v for v in (words.number(s.get("coverage")) for s in steps) if math.isfinite(v)
    ]
    text += (
        f", and their 95{words.GAP}% intervals held {_range(held)} of the true"
        " parameters"
        if held
        else ""
    )
    lost = [
        v
        for v in (words.number(s.get("realised_lost")) for s in steps)
        if math.isfinite(v)
    ]
    if lost:
        expected = sum(
            v for v in (words.number(s.get("lost")) for s in steps) if math.isfinite(v)
        )
        text += (
            f"; they lost {words.plain(sum(lost), 3)} candidates on average,"
            f" {words.plain(expected, 3)} were expected"
        )
    return [Paragraph(f"{text}.")]


def _range(shares: Sequence[float]) -> str:
    low, high = words.percent(min(shares)), words.percent(max(shares))
    return low if low == high else f"{low} to {high}"


# -- stage by stage --------------------------------------------------------------------


def _order(plan: Part) -> Table:
    """The stages in order: when, what, how much of it, what it sees."""
    steps = plan["stages"]
    operators = any(s.get("operator") for s in steps)
    told: list[tuple[TableColumn, list[str]]] = [
        (TableColumn("Stage", number=True), [str(k) for k in range(1, len(steps) + 1)]),
        (TableColumn("Minutes", number=True), [_span(s) for s in steps]),
        (TableColumn("Measurement", wide=True), [str(s["measurement"]) for s in steps]),
        (
            TableColumn("Set-ups", wide=True),
            [words.listing(map(str, s["setups"])) for s in steps],
        ),
        *(
            [
                (
                    TableColumn("Operator"),
                    [str(s.get("operator") or words.MISSING) for s in steps],
                )
            ]
            if operators
            else []
        ),
        (TableColumn("Readings", number=True), [str(s["readings"]) for s in steps]),
        (TableColumn("Lost, expected", number=True), [_lost(s) for s in steps]),
        (TableColumn("Rank alone", number=True), [str(s["identifies"]) for s in steps]),
        (
            TableColumn("Rank so far", number=True),
            [_or_missing(s.get("rank")) for s in steps],
        ),
    ]
    if any(s.get("price") for s in steps):
        told.append(
            (
                TableColumn("Price", number=True),
                [words.plain(s.get("price")) for s in steps],
            )
        )
    return Table(
        [c for c, _ in told],
        transposed([cells for _, cells in told]),
        _order_caption(plan),
    )


def _order_caption(plan: Part) -> str:
    text = f"The stages in order, {_minutes(plan['cost'])} together{_of_budget(plan)}. "
    text += (
        "Lost are candidates (readings or whole runs) expected out of the instrument's"
        " travel. Rank alone counts what a stage's own readings see, its set-ups'"
        " unknowns among it; rank so far is of the machine's parameters."
    )
    least = [
        words.number((s.get("available") or {}).get("least")) for s in plan["stages"]
    ]
    known = [v for v in least if math.isfinite(v)]
    text += (
        " The least sure reading is taken with a chance of"
        f" {words.percent(min(known))}."
        if known
        else ""
    )
    cut = [
        v
        for v in (words.number(s.get("cut_off_um")) for s in plan["stages"])
        if math.isfinite(v)
    ]
    if cut:
        text += (
            " After the last stage, linearisation leaves out"
            f" {words.quantity(cut[-1], 'um')} of a reading at most."
        )
    return text


def _span(stage: Part) -> str:
    return f"{words.plain(stage.get('begin_min'), 3)}–{words.plain(stage.get('end_min'), 3)}"


def _lost(stage: Part) -> str:
    lost = words.number(stage.get("lost"))
    if not math.isfinite(lost):
        return words.MISSING
    of = f" of {stage['chosen']}" if stage.get("chosen") else ""
    return f"{'0' if lost < 0.005 else words.plain(lost, 2)}{of}"


def _identified(plan: Part, machine: Part) -> Table:
    """Which parameters each stage tightens most, and what is still held."""
    usual = {p["name"]: p for p in machine.get("parameters") or []}
    before = {
        n: {"sd": p.get("tolerance"), "unit": p.get("unit")} for n, p in usual.items()
    }
    rows = []
    for k, stage in enumerate(plan["stages"], 1):
        after = stage.get("parameters") or {}
        held = (
            words.listing((_cut(str(h)) for h in stage.get("held") or []), 8)
            or "nothing"
        )
        rows.append(
            [str(k), str(stage["measurement"]), _tightened(before, after), held]
        )
        before = after
    columns = [
        TableColumn("Stage", number=True),
        TableColumn("Measurement"),
        TableColumn("Improved most", wide=True),
    ]
    columns.append(TableColumn("Still held", wide=True))
    caption = (
        "What each stage identifies: the parameters whose standard deviations it"
        " improves most, with the factor against their tolerances or the stage before."
        " Held are parameters and combinations that no reading so far tells; no stage"
        " frees what it cannot see."
    )
    return Table(columns, rows, caption)


def _tightened(before: Mapping[str, Part], after: Mapping[str, Part]) -> str:
    """The few parameters that improved most: db1y 0.012 mm (84×)."""
    gains = {}
    for name, now in after.items():
        was = before.get(name) or {}
        sd, old = words.number(now.get("sd")), words.number(was.get("sd"))
        if sd > 0.0 and old > IMPROVED * sd and was.get("unit") == now.get("unit"):
            gains[name] = old / sd
    best = sorted(gains, key=lambda n: -gains[n])[:TOLD]
    told = [
        f"{n} {words.quantity(after[n]['sd'], after[n]['unit'], 2)}"
        f" ({words.num(gains[n], 2)}×)"
        for n in best
    ]
    more = len(gains) - len(best)
    return f"{', '.join(told)}{f' and {more} more' if more else ''}" if told else "none"


def _accuracy(plan: Part) -> Table:
    """Accuracy before, after each stage, and as wanted; what virtual machines made of
    it below each stage.
    """
    keys = stages.components(plan)
    rows, marks = (
        [
            [
                "before any reading" if not plan.get("after") else "before",
                *_cells(plan, "start_accuracy", keys),
            ]
        ],
        [""],
    )
    for k, stage in enumerate(plan["stages"], 1):
        rows.append([f"after stage {k}", *_cells(stage, "accuracy", keys)])
        marks.append("chosen" if k == len(plan["stages"]) else "")
        true = stages.realised(stage)
        if true:
            rows.append(
                [
                    "… realised, virtual machines",
                    *[words.num(true.get(key)) for key in keys],
                ]
            )
            marks.append(marks[-1])
    if plan.get("goal"):
        rows.append(["wanted", *_cells(plan, "goal", keys)])
        marks.append("")
    if plan.get("goal") and not plan.get("reached", True):
        rows.append(["most accurate plan found", *_cells(plan, "best_reachable", keys)])
        marks.append("")
    columns = [
        TableColumn("", wide=True),
        *number_column(*[words.heading(key) for key in keys]),
    ]
    return Table(
        columns,
        rows,
        "Accuracy of each component, rms over the workspace, stage by stage.",
        marks,
    )


def _cells(part: Part, field: str, keys: Sequence[str]) -> list[str]:
    return [words.num((part.get(field) or {}).get(key)) for key in keys]


# -- captions of the figures -----------------------------------------------------------


def _lines(plan: Part) -> str:
    """What is left of each component, against what was."""
    text = "Predicted rms error of each component after each stage, on log scales."
    start, left = (
        plan.get("start_accuracy") or {},
        (plan["stages"][-1].get("accuracy") or {}),
    )
    gains = {
        k: words.number(start.get(k)) / words.number(v)
        for k, v in left.items()
        if words.number(v) > 0.0
    }
    known = {k: v for k, v in gains.items() if math.isfinite(v)}
    if known:
        low, high = (
            min(known, key=lambda k: known[k]),
            max(known, key=lambda k: known[k]),
        )
        text += (
            f" The plan as a whole makes {words.parted(low)[0]}"
            f" {words.factor(known[low])} as accurate"
        )
        text += (
            f" and {words.parted(high)[0]} {words.factor(known[high])}."
            if high != low
            else "."
        )
    text += (
        " Diamonds are what virtual machines came out with."
        if any(s.get("realised") for s in plan["stages"])
        else ""
    )
    return f"{text} Dotted lines are what is wanted." if plan.get("goal") else text


def _times(plan: Part) -> str:
    text = f"The stages over time: {_minutes(plan['cost'])}{_of_budget(plan)}."
    left = words.number(plan.get("budget_min")) - words.number(plan["cost"])
    return f"{text} {_minutes(left)} are left." if left > 0.5 else text


def _front(plan: Part) -> str:
    text = (
        "What time buys: plans of which none found is both shorter and more accurate,"
        " the plan among them, and, shaded, where no plan within the budget can be."
    )
    found = front.points(plan.get("front") or [])
    if len(found) > 1:
        (first, rough), (last, fine) = found[0], found[-1]
        text += (
            f" From {_minutes(first)} to {_minutes(last)} the value falls from"
            f" {words.num(rough)} to {words.num(fine)}."
        )
    more = len(plan.get("compared") or []) - front.MOST
    return f"{text} {more} more sequences are in the table only." if more > 0 else text


# -- beside the plan -------------------------------------------------------------------


def _rejected(plan: Part) -> list[Block]:
    """What was looked at and not taken, and why."""
    others = plan.get("alternatives") or []
    ways = [way for way in others if isinstance(way, Mapping)]
    said = [
        words.sentence(str(text)) for text in others if not isinstance(text, Mapping)
    ]
    extra: list[Block] = (
        [Paragraph("Alternatives that were looked at:"), Items(said)] if said else []
    )
    if not ways:
        return extra
    rows = [
        [_named(w), words.num(w.get("minutes")), words.num(w.get("value")), _why(w)]
        for w in ways
    ]
    columns = [
        TableColumn("Plan (readings or runs)", wide=True),
        *number_column("Minutes", "Value"),
    ]
    columns.append(TableColumn("Why not", wide=True))
    judged = (
        "error of the worst component over what is wanted of it"
        if plan.get("goal")
        else "share of error left"
    )
    caption = (
        f"Plans that were looked at and not taken. Value: {judged}, the smaller the"
        " better. The plan itself: "
    )
    caption += f"{_minutes(plan['cost'])}, value {words.num(plan.get('value'))}."
    return [Table(columns, rows, caption), *extra]


def _why(way: Part) -> str:
    return words.sentence(str(way["why"])) if way.get("why") else words.MISSING


def _named(way: Part) -> str:
    """The measurements of a plan in order: rough tracker (12) → bar 300 (24)."""
    counts = list(way.get("readings") or [])
    counts += [None] * (len(way["names"]) - len(counts))
    told = [
        f"{name} ({n})" if n is not None else str(name)
        for name, n in zip(way["names"], counts, strict=False)
    ]
    return " → ".join(told) or "no reading"


def _compared(plan: Part) -> list[Block]:
    """Sequences that were asked for, each beside the best plan of its time."""
    compared = plan.get("compared") or []
    if not compared:
        return []
    said = [
        f"{s['name']}: {words.sentence(str(s['words']))}"
        for s in compared
        if s.get("words")
    ]
    told: list[Block] = [Items(said)] if said else []
    return [_seen(compared), _side_by_side(compared), *told]


def _seen(compared: Sequence[Part]) -> Table:
    names = list(
        dict.fromkeys(key for s in compared for key in s.get("observability") or {})
    )
    cells = [
        [str(s["name"]) for s in compared],
        [_total(s["way"].get("readings")) for s in compared],
        [words.num(s["way"].get("minutes")) for s in compared],
        [f"{s['rank']} of {s['parameters']}" for s in compared],
        [words.num(s.get("kappa"), 4) for s in compared],
        [words.num(s.get("weakest")) for s in compared],
        *[
            [words.num((s.get("observability") or {}).get(name)) for s in compared]
            for name in names
        ],
        [words.plain(s.get("lost"), 2) for s in compared],
    ]
    columns = [
        TableColumn("Sequence", wide=True),
        *number_column("Readings", "Minutes", "Rank", "κ", "Weakest", *names, "Lost"),
    ]
    caption = (
        "Sequences that were asked for, with all readings of each measurement: what"
        " they see. Weakest is the least singular value (lengths in mm, angles times"
        " the lever), O1 to O5 are the observability indices, larger is better; the"
        " smaller κ, the better."
    )
    return Table(columns, transposed(cells), caption)


def _side_by_side(compared: Sequence[Part]) -> Table:
    """Three lines for each sequence: itself, the best plan of its time, how many times
    as accurate that is.
    """
    ways: Iterable[Part] = (way for s in compared for way in (s["way"], s["plan"]))
    keys = list(dict.fromkeys(key for way in ways for key in way.get("accuracy") or {}))
    rows, marks = [], []
    for s in compared:
        for way, name, bound, mark in (
            (s["way"], str(s["name"]), "", ""),
            (s["plan"], _named(s["plan"]), words.num(s.get("bound")), "chosen"),
        ):
            head = [
                name,
                words.num(way.get("minutes")),
                words.num(way.get("value")),
                bound,
            ]
            rows.append([*head, *_cells(way, "accuracy", keys)])
            marks.append(mark)
        gain = s.get("gain") or {}
        if gain:
            factors = [
                words.factor(gain.get(key, gain.get(stages.stem(key)))) for key in keys
            ]
            rows.append(["… times as accurate", "", "", "", *factors])
            marks.append("chosen")
    columns = [
        TableColumn("Sequence", wide=True),
        *number_column("Minutes", "Value", "Bound"),
    ]
    columns += number_column(*[words.heading(key) for key in keys])
    caption = (
        "Each sequence beside the best plan found in its time (marked): value, the"
        " smaller the better, and rms error of each component. No plan of that time has"
        " a value below the bound."
    )
    return Table(columns, rows, caption, marks)


# -- words -----------------------------------------------------------------------------


def _minutes(value: Any) -> str:
    return words.quantity(value, "min")


def _within(plan: Part) -> str:
    budget = words.number(plan.get("budget_min"))
    return (
        f" within {words.with_unit(words.plain(budget), 'min')}"
        if math.isfinite(budget)
        else ""
    )


def _of_budget(plan: Part) -> str:
    budget = words.number(plan.get("budget_min"))
    return (
        f" of the {words.with_unit(words.plain(budget), 'min')} there are"
        if math.isfinite(budget)
        else ""
    )


def _listed(accuracy: Part, only: Iterable[str] | None = None) -> str:
    """z 30.0 µm and theta 2.00 arcsec."""
    keys = [
        key
        for key in (accuracy if only is None else only)
        if math.isfinite(words.number(accuracy.get(key)))
    ]
    return words.listing(
        f"{words.parted(k)[0]}{words.GAP}{words.quantity(accuracy[k], words.parted(k)[1])}"
        for k in keys
    )


def _or_missing(value: Any) -> str:
    return words.MISSING if value is None else str(value)


def _total(counts: Any) -> str:
    return words.plain(sum(counts)) if counts else words.MISSING
