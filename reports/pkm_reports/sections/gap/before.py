"""What the readings could find before any is taken: detectable sizes, rivals, and runs
that tell effects apart.
"""

from __future__ import annotations

from collections.abc import Mapping
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
from pkm_reports.figures.gap import confusable
from pkm_reports.figures.gap.causes import spoken

ANCHOR: Final = "gap-before"
TITLE: Final = "What these readings could find"
Part = Mapping[str, Any]
#: rows of the table of imitated combinations
MOST: Final = 16
CONDITIONS: Final = {"direction": "", "payload": "N", "feed": "mm/min", "time": "min"}
MINUTE, FEED = 60.0, 1e-3 / 60.0


def present(result: Part) -> bool:
    """Whether it was looked at."""
    return bool(result.get("gap_before"))


def blocks(result: Part) -> list[Block]:
    """Findings, chosen runs, detectable sizes, confusability, combinations that are
    imitated, what cannot be tested.
    """
    before: Part = result["gap_before"]
    made: list[Block] = [
        Items(
            [words.pretty(words.sentence(w)) for w in before.get("words") or []],
            numbered=True,
        )
    ]
    chosen, units = before.get("chosen"), before.get("units") or {}
    if chosen:
        made += [_runs(chosen), _told(chosen)]
        made += _table(chosen["table"], units, "the chosen runs", "gap_before_chosen")
    return made + _table(
        before["table"],
        units,
        "the readings planned" if chosen else "these readings",
        "gap_before",
    )


def _runs(chosen: Part) -> Block:
    known = [c for c in CONDITIONS if any(c in r["condition"] for r in chosen["runs"])]
    columns = [TableColumn("Set-up"), TableColumn("Run", wide=True)]
    titles = [
        f"{c.capitalize()} [{CONDITIONS[c]}]" if CONDITIONS[c] else c.capitalize()
        for c in known
    ]
    columns += number_column(
        *[t.replace("Time", "Start") for t in titles], "Takes [min]"
    )
    rows = [
        [
            str(r["setup"]),
            str(r["run"]),
            *[_condition(r, c) for c in known],
            words.num(r["seconds"] / MINUTE, 2),
        ]
        for r in chosen["runs"]
    ]
    share = words.certain(chosen["efficiency"])
    text = (
        f"{words.count(len(rows) - chosen['kept'], 'run')} chosen out of"
        f" {chosen['candidates']}"
    )
    text += f", beside {chosen['kept']} kept ones" if chosen["kept"] else ""
    text += f": {words.num(chosen['seconds'] / MINUTE)} min with mounting. "
    known_best = (
        "All plans were tried: none is better."
        if chosen["proven"]
        else f"At least {share} of the best plan."
    )
    return Table(columns, rows, text + known_best)


def _condition(run: Part, name: str) -> str:
    value = run["condition"].get(name)
    if value is None:
        return words.MISSING
    if name == "direction":
        return "+1" if value > 0 else f"{words.MINUS}1"
    return words.plain(value / {"feed": FEED, "time": MINUTE}.get(name, 1.0))


def _told(chosen: Part) -> Block:
    rows, marks = [], []
    for t in chosen["told"]:
        form = "" if t["words"] == spoken(t["effect"]) else f", {t['words']}"
        row = [
            f"{spoken(t['effect'])}{form}",
            spoken(t["rival"]),
            words.num(t["before"]),
            words.num(t["apart"]),
        ]
        rows.append([*row, words.num(t["seen"])])
        marks.append("good" if t["apart"] >= confusable.LIMIT else "")
    columns = [
        TableColumn("Effect", wide=True),
        TableColumn("Told from"),
        *number_column("Before", "Now", "Without the rival"),
    ]
    limit = words.plain(confusable.LIMIT)
    caption = (
        "How well each form of an effect is told from its rival, in units of the"
        f" noise; {limit} and more is good. "
    )
    caption += (
        "Before: by the readings planned without the choice of runs. No plan has a"
        " least value above "
    )
    return Table(columns, rows, caption + f"{words.num(chosen['bound'])}.", marks)


def _table(table: Part, units: Mapping[str, str], of: str, name: str) -> list[Block]:
    made: list[Block] = []
    tested = sorted(
        (e for e in table["effects"] if not e["not_testable"]),
        key=lambda e: -e["detectability"],
    )
    if tested:
        made.append(_sizes(tested, table, units, of))
        text = (
            f"Effects told from one another by {of}: how well the effect of the row is"
            " seen once the one of the "
        )
        text += (
            "column may explain it too, in units of the noise: the first at its"
            " expected size, the other of any "
        )
        text += "size. Framed: how well it is seen where nothing else acts."
        made.append(Picture(name, lambda: confusable.draw(table), text))
    return made + _imitated(tested, of) + _untested(table)


def _sizes(tested: list[Part], table: Part, units: Mapping[str, str], of: str) -> Block:
    rows, marks = [], []
    for e in tested:
        hardest = e["rivals"][0] if e["rivals"] else None
        rows.append(
            [
                spoken(e["name"]),
                _lengths(e["signature"], units),
                words.percent(e["absorbed"]),
                words.num(e["detectability"]),
                words.percent(e["power"]),
                _lengths(e["median"], units),
                (
                    f"{spoken(hardest['name'])} ({confusable.short(hardest['apart'])})"
                    if hardest
                    else words.MISSING
                ),
            ]
        )
        marks.append("good" if e["visible"] else "bad")
    titles = ("Expected rms", "Absorbed", "Seen", "Chance", "Least rms")
    columns = [
        TableColumn("Effect", wide=True),
        *number_column(*titles),
        TableColumn("Hardest rival", wide=True),
    ]
    caption = (
        f"What {of} ({words.count(table['readings'], 'reading')}) could find. Absorbed:"
        " share that calibration takes for geometry. Seen: what is left, in units of"
        " the noise. Chance: of finding it at 1 % false alarm. Least rms: size that is"
        " found 9 times in 10, typically. Hardest rival: the effect that explains most"
        " of it, and what is seen then. The noise is that stated in the study."
    )
    return Table(columns, rows, caption, marks)


def _lengths(by_channel: Mapping[str, Any], units: Mapping[str, str]) -> str:
    shown = {n: v for n, v in by_channel.items() if v is None or v > 1e-9}
    told = [words.quantity(v, str(units.get(n, ""))) for n, v in shown.items()]
    return words.listing(
        told
        if len(told) < 2
        else [f"{n} {t}" for n, t in zip(shown, told, strict=True)]
    )


def _imitated(tested: list[Part], of: str) -> list[Block]:
    found = [(e, r, s) for e in tested for r in e["rivals"] for s in r["shared"]]
    found.sort(key=lambda x: x[2]["apart"] - 1e-3 * x[2]["seen"])
    rows = [
        [
            spoken(e["name"]),
            s["words"],
            spoken(r["name"]),
            words.num(s["seen"], 2),
            words.num(s["apart"], 2),
        ]
        for e, r, s in found[:MOST]
    ]
    if not rows:
        return []
    columns = [
        TableColumn("Effect"),
        TableColumn("Coefficients", wide=True),
        TableColumn("Imitated by"),
    ]
    columns += number_column("Seen", "Then")
    cut = f" The {len(rows)} nearest of {len(found)}." if len(found) > len(rows) else ""
    caption = (
        f"Forms of an effect that {of} could see, but not tell from another effect:"
        f" seen alone, and then.{cut}"
    )
    return [Table(columns, rows, caption)]


def _untested(table: Part) -> list[Block]:
    missing = [e for e in table["effects"] if e["not_testable"]]
    if not missing:
        return []
    told = [
        words.sentence(f"{spoken(e['name']).capitalize()}: {e['not_testable']}")
        for e in missing
    ]
    return [Paragraph("Effects that could not be tested:"), Items(told)]
