"""Relations of what causes a gap, found or foreseen."""

from __future__ import annotations

from collections.abc import Iterator

from oed.result.gap import GapSection, Trace
from oed.result.gap_before import (
    ChosenRuns,
    DetectabilityTable,
    GapBeforeSection,
)
from oed.result.relations import base
from oed.result.relations.base import Breach
from oed.result.study import StudyResult

VERDICTS = ("none", "effect", "class", "mixture", "unknown", "scatter")
SPLITS = ("within", "whole")
KINDS = ("circle", "line", "points")
SERIES = ("before", "explained", "unexplained", "after")


def breaches(result: StudyResult) -> Iterator[Breach]:
    """Contradictions of a diagnosis, and of what plans could find."""
    if result.gap is not None:
        yield from _gap(result.gap)
    if result.gap_before is not None:
        yield from _gap_before(result.gap_before)


def _gap(section: GapSection) -> Iterator[Breach]:
    yield from base.known("gap.verdict", [section.verdict], VERDICTS, "its values")
    for name in ("answers", "set95"):
        for k, answer in enumerate(getattr(section, name), start=1):
            # an unknown effect has no class
            field, most = f"gap.{name}[{k}].classes", len(answer.effects)
            yield from base.within(field, len(answer.classes), 0, most)
    for k, closure in enumerate(section.closure, start=1):
        field = f"gap.closure[{k}].split"
        yield from base.known(field, [closure.split], SPLITS, "its values")
    if section.tried:
        yield from base.known(
            "gap.selected", section.selected, section.tried, "gap.tried"
        )
    yield from _sizes(section)
    for k, trace in enumerate(section.traces, start=1):
        yield from _trace(f"gap.traces[{k}]", trace)
    yield from base.points("gap.spots", [spot.at for spot in section.spots])


def _sizes(section: GapSection) -> Iterator[Breach]:
    """Channels of sizes and residuals; effects of coefficients."""
    for k, size in enumerate(section.sizes, start=1):
        field = f"gap.sizes[{k}]"
        yield from base.same_names(f"{field}.rms", size.rms, section.units, "gap.units")
        yield from base.known(
            f"{field}.effect", [size.effect], section.selected, "gap.selected"
        )
    for name in ("rms_before", "rms_after"):
        values = getattr(section, name)
        yield from base.known(f"gap.{name}", values, section.units, "gap.units")
    yield from base.same_names(
        "gap.rms_after", section.rms_after, section.rms_before, "gap.rms_before"
    )
    for k, coefficient in enumerate(section.coefficients, start=1):
        field = f"gap.coefficients[{k}].effect"
        of = "gap.selected"
        yield from base.known(field, [coefficient.effect], section.selected, of)


def _trace(field: str, trace: Trace) -> Iterator[Breach]:
    yield from base.known(f"{field}.kind", [trace.kind], KINDS, "its values")
    for name in SERIES:
        values = getattr(trace, name)
        yield from base.lengths(f"{field}.{name}", values, f"{field}.at", len(trace.at))


def _gap_before(section: GapBeforeSection) -> Iterator[Breach]:
    yield from _table("gap_before.table", section.table, section)
    if section.chosen is not None:
        yield from _chosen("gap_before.chosen", section.chosen, section)


def _table(
    field: str, table: DetectabilityTable, section: GapBeforeSection
) -> Iterator[Breach]:
    count = len(table.names)
    for key, rows in (("apart", table.separation), ("angles_deg", table.angles_deg)):
        yield from base.table(f"{field}.{key}", rows, f"{field}.names", count, count)
    effects = [record.name for record in table.effects]
    yield from base.known(f"{field}.names", table.names, effects, f"{field}.effects")
    for key, groups in (
        ("classes", table.classes),
        ("absorbed", table.absorbed),
        ("exact", table.exact),
    ):
        for k, group in enumerate(groups, start=1):
            of = f"{field}.effects"
            yield from base.known(f"{field}.{key}[{k}]", group, effects, of)
    for key, pairs in (("absorbed", table.absorbed), ("exact", table.exact)):
        for k, pair in enumerate(pairs, start=1):
            yield from base.lengths(f"{field}.{key}[{k}]", pair, "a pair", 2)
    for k, record in enumerate(table.effects, start=1):
        for part in ("signature", "least", "median"):
            at, values = f"{field}.effects[{k}].{part}", getattr(record, part)
            yield from base.known(at, values, section.units, "gap_before.units")


def _chosen(
    field: str, chosen: ChosenRuns, section: GapBeforeSection
) -> Iterator[Breach]:
    yield from _table(f"{field}.table", chosen.table, section)
    if chosen.runs:
        conditions = [run.condition for run in chosen.runs]
        yield from base.same_keys(f"{field}.runs", conditions)
