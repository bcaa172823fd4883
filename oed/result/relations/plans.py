"""Relations of what is planned: identifiability, design, stages, drawing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from oed.result.design import DesignSection, HowManySummary, RobustSummary
from oed.result.identifiability import IdentifiabilitySection, KappaMap
from oed.result.plan import PlanSection
from oed.result.relations import base
from oed.result.relations.base import LARGEST_LOGARITHM, Breach
from oed.result.study import Drawing, MachineInfo, StudyResult

#: what a criterion compares may be the logarithm of a size, or minus a variance
LOGARITHMS = (-LARGEST_LOGARITHM, LARGEST_LOGARITHM)

#: columns of the machine's table that others look up, and their types
PARAMETER: Final[dict[str, Any]] = {
    "name": str,
    "unit": str,
    "nominal": (int, float),
    "tolerance": (int, float),
}


def breaches(result: StudyResult) -> Iterator[Breach]:
    """Contradictions of the sections that a plan makes."""
    yield from _machine(result.machine)
    setups = [setup.name for setup in result.setups]
    for name, variant in result.identifiability_of.items():
        yield from _identifiability(f"identifiability_of.{name}", variant)
    if result.identifiability is not None:
        yield from _identifiability("identifiability", result.identifiability)
    for k, kappa in enumerate(result.kappa_maps, start=1):
        yield from _kappa_map(f"kappa_maps[{k}]", kappa)
    if result.design is not None:
        yield from _design(result.design, setups)
    if result.plan is not None:
        yield from _plan(result.plan)
    if result.drawing is not None:
        yield from _drawing(result.drawing, setups)


def _machine(machine: MachineInfo) -> Iterator[Breach]:
    """Parameters without name, unit or numbers: a later stage looks them up."""
    for k, row in enumerate(machine.parameters, start=1):
        field = f"machine.parameters[{k}]"
        for key, kind in PARAMETER.items():
            if not isinstance(row.get(key), kind):
                yield Breach(f"{field}.{key}", f"{row.get(key)!r} is no {key}")


def _identifiability(field: str, section: IdentifiabilitySection) -> Iterator[Breach]:
    yield from base.lengths(
        f"{field}.parameters", section.parameters, f"{field}.n", section.n
    )
    yield from base.within(f"{field}.rank", section.rank, 0, section.n)
    values = f"{field}.singular_values"
    count = len(section.singular_values)
    yield from base.within(values, count, section.rank, section.n)
    for k, value in enumerate(section.singular_values, start=1):
        yield from base.within(f"{values}[{k}]", value, 0.0, base.LARGEST)
    for name in ("combinations", "lost"):
        for k, terms in enumerate(getattr(section, name), start=1):
            at = f"{field}.{name}[{k}]"
            yield from base.known(at, terms, section.parameters, f"{field}.parameters")


def _kappa_map(field: str, section: KappaMap) -> Iterator[Breach]:
    height, width = len(section.circles), len(section.points)
    other = f"{field}.circles x points"
    yield from base.table(f"{field}.kappa", section.kappa, other, height, width)
    yield from base.ascending(f"{field}.circles", section.circles)
    yield from base.ascending(f"{field}.points", section.points)


def _design(section: DesignSection, setups: list[str]) -> Iterator[Breach]:
    for k, pose in enumerate(section.poses, start=1):
        if setups:
            field = f"design.poses[{k}].setup"
            yield from base.known(field, [pose.setup], setups, "setups")
    for k, entry in enumerate(section.compared, start=1):
        names = [other.name for other in section.compared]
        field = f"design.compared[{k}].values"
        yield from base.known(field, entry.values, names, "design.compared")
    if section.gap is not None:
        yield from base.within("design.gap", section.gap, *LOGARITHMS)
    if section.robust is not None:
        yield from _robust(section.robust)
    if section.how_many is not None:
        yield from _how_many(section.how_many)


def _robust(summary: RobustSummary) -> Iterator[Breach]:
    for name in ("values", "nominal_values"):
        field, values = f"design.robust.{name}", getattr(summary, name)
        yield from base.lengths(
            field, values, "design.robust.scenarios", summary.scenarios
        )
        for k, value in enumerate(values, start=1):
            if value is not None:
                yield from base.within(f"{field}[{k}]", value, *LOGARITHMS)
    for name in ("value", "bound", "nominal"):
        yield from base.within(
            f"design.robust.{name}", getattr(summary, name), *LOGARITHMS
        )


def _how_many(summary: HowManySummary) -> Iterator[Breach]:
    count = len(summary.sizes)
    yield from base.ascending("design.how_many.sizes", summary.sizes)
    for name in ("accuracy", "bound"):
        for key, values in getattr(summary, name).items():
            field = f"design.how_many.{name}.{key}"
            yield from base.lengths(field, values, "design.how_many.sizes", count)
    for name in ("wanted", "bound"):
        field, names = f"design.how_many.{name}", getattr(summary, name)
        of = "design.how_many.accuracy"
        yield from base.known(field, names, summary.accuracy, of)


def _plan(section: PlanSection) -> Iterator[Breach]:
    for k, stage in enumerate(section.stages, start=1):
        field = f"plan.stages[{k}]"
        if section.start_accuracy:
            of = "plan.start_accuracy"
            field = f"{field}.accuracy"
            yield from base.known(field, stage.accuracy, section.start_accuracy, of)
    for name in ("accuracy", "goal", "best_reachable"):
        names = getattr(section, name)
        if section.start_accuracy:
            of = "plan.start_accuracy"
            yield from base.known(f"plan.{name}", names, section.start_accuracy, of)
    for k, sequence in enumerate(section.compared, start=1):
        field = f"plan.compared[{k}].gain"
        of = f"plan.compared[{k}].plan.accuracy"
        yield from base.known(field, sequence.gain, sequence.plan.accuracy, of)


def _drawing(section: Drawing, setups: list[str]) -> Iterator[Breach]:
    count, other = len(section.tool_points), "drawing.tool_points"
    yield from base.points(other, section.tool_points)
    yield from base.lengths("drawing.reading_of", section.reading_of, other, count)
    if setups:
        yield from base.known(
            "drawing.reading_of", set(section.reading_of), setups, "setups"
        )
    # older versions list only the bars of readings that have one
    yield from base.within("drawing.bars", len(section.bars), 0, count)
    for name in ("runs", "commands"):
        values = getattr(section, name)
        if values:
            yield from base.lengths(f"drawing.{name}", values, other, count)
    yield from base.same_commands("drawing.commands", section.commands)
    for k, line in enumerate(section.lines, start=1):
        yield from base.points(f"drawing.lines[{k}].points", line.points)
    for k, bar in enumerate(section.bars, start=1):
        if bar:
            yield from base.lengths(f"drawing.bars[{k}]", bar, "a bar", 2)
        yield from base.points(f"drawing.bars[{k}]", bar)
    yield from base.points("drawing.labels", [label.at for label in section.labels])
