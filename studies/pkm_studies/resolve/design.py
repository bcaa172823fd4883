"""What [design] and [[kappa]] say, as objects: candidates, given plans, what is asked
for; all SI.

Raises InputError, naming file and field, for everything that does not fit the machine
or the instruments.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import get_args

import numpy as np

from oed import units
from oed.arrays import Array
from oed.measurement import Measurement, Series
from pkm_studies.errors import Place, suggest
from pkm_studies.resolve import grids, naming, quantities
from pkm_studies.resolve import limits as resolve_limits
from pkm_studies.resolve.grids import Circles, ReferencePlan
from pkm_studies.study.fields import CriterionName
from pkm_studies.study.load import KappaTable, Study
from pkm_studies.study.tables import DesignTable

#: share of what an instrument holds by which a candidate's reading may differ from it
UNHELD = 0.01
#: criteria by their names in the schema, and those that polishing knows
KNOWN: tuple[str, ...] = get_args(CriterionName)
POLISHED = ("D", "O1", "Ds", "A", "c", "I", "E", "O3")

Ranges = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Asked:
    """What [design] asks for, in SI.

    interest     names of the parameters that Ds judges
    combination  {parameter: coefficient} of c
    accuracy     {component: wanted accuracy} that I and G scale by; the others do not
                 count
    apart        (n_dof,) least distance along each command coordinate, 0 where none is
                 asked; None: not asked
    kept         readings that belong to the plan already
    free         set-up -> setting or tool coordinate -> range, for polishing
    """

    interest: tuple[str, ...]
    combination: Mapping[str, float]
    accuracy: Mapping[str, float]
    apart: Array | None
    kept: tuple[Series, ...]
    free: Ranges


def asked(
    study: Study, measurement: Measurement, references: Sequence[ReferencePlan]
) -> Asked | None:
    """What the study's [design] asks for; None without one. `measurement` holds all
    set-ups.
    """
    said = study.design
    if said is None:
        return None
    place = study.place.key("design")
    _sound(study, said, place)
    return Asked(
        interest=_interest(said, measurement, place.key("interest")),
        combination=_combination(said, measurement, place.key("combination")),
        accuracy=_accuracy(said, measurement, place.key("accuracy")),
        apart=_apart(said, measurement, place.key("apart")),
        kept=_kept(study, said, measurement, references, place),
        free=_free(said, measurement, place.key("polish").key("free")),
    )


def _sound(study: Study, said: DesignTable, place: Place) -> None:
    """Fields that need each other."""
    for name in said.compound:
        naming.known(name, KNOWN, place.key("compound").key(name), "criterion")
    for i, name in enumerate(said.compare):
        naming.known(name, KNOWN, place.key("compare").item(i), "criterion")
    if said.compound and said.criterion != "D":
        raise place.key("compound").error(
            "a criterion is given as well", "keep criterion or compound"
        )
    if said.prior and said.scaling != "tolerance":
        raise place.key("prior").error(
            "tolerances enter in their own unit",
            'write scaling = "tolerance" beside it',
        )
    field = "compound" if said.compound else "criterion"
    for key, some in ((field, said.criteria), ("compare", said.compare)):
        for name in some:
            _needs(study, said, name, place.key(key))
    if said.robust is not None and not said.prior:
        problem = "drawn machines do not all see the same directions without tolerances"
        raise place.key("robust").error(
            problem, 'write scaling = "tolerance" and prior = true'
        )
    if said.how_many is not None:
        _needs(study, said, "I", place.key("how_many"))
    if said.setups_max is not None and not said.prior:
        problem = (
            "each set-up brings unknowns of its own: without tolerances, fewer set-ups"
            " always leave fewer"
        )
        raise place.key("setups_max").error(
            problem, 'write scaling = "tolerance" and prior = true', said.setups_max
        )
    if (
        said.polish is not None
        and said.polish.enabled
        and said.judged_by not in POLISHED
    ):
        problem = f"criterion {said.judged_by} has no slope to polish along"
        raise place.key("polish").error(
            problem, f"take one of {', '.join(POLISHED)}, or leave polishing out"
        )
    if said.keep is not None and said.keep_readings is not None:
        raise place.key("keep").error(
            "keep_readings is given as well", "keep one of the two", said.keep
        )


def _needs(study: Study, said: DesignTable, name: str, place: Place) -> None:
    if name in ("I", "G") and study.prediction is None:
        raise place.error(
            "accuracy over which workspace?", "add a [prediction] table", name
        )
    if name in ("I", "G") and not said.prior:
        problem = "accuracy depends on the tolerances of what no reading sees"
        raise place.error(problem, 'write scaling = "tolerance" and prior = true', name)
    if name == "c" and not said.combination:
        raise place.error(
            "which combination?", "add combination = { PARAMETER = 1.0 }", name
        )


# -- what is judged --------------------------------------------------------------------


def _unknown(measurement: Measurement) -> list[str]:
    return [
        n for n, free in zip(measurement.names, measurement.free, strict=True) if free
    ]


def _interest(
    said: DesignTable, measurement: Measurement, place: Place
) -> tuple[str, ...]:
    free = _unknown(measurement)
    if not said.interest:
        return tuple(n for n in free if "." not in n)
    return tuple(naming.match(said.interest, free, place))


def _combination(
    said: DesignTable, measurement: Measurement, place: Place
) -> dict[str, float]:
    free = _unknown(measurement)
    for name in said.combination:
        naming.known(name, free, place.key(name), "parameter")
    if said.combination and not any(said.combination.values()):
        raise place.error("all coefficients are 0", "give one that is not")
    return dict(said.combination)


def _accuracy(
    said: DesignTable, measurement: Measurement, place: Place
) -> dict[str, float]:
    machine = measurement.machine
    known = {c.name: c.unit for c in machine.components}
    if said.accuracy:
        return quantities.read(said.accuracy, known, place)
    return {
        name: 1.0 if unit == "m" else 1.0 / machine.lever
        for name, unit in known.items()
    }


def _apart(said: DesignTable, measurement: Measurement, place: Place) -> Array | None:
    if not said.apart:
        return None
    values = quantities.read(said.apart, grids.wanted(measurement.machine), place)
    return np.array([values.get(c.name, 0.0) for c in measurement.machine.command])


def _kept(
    study: Study,
    said: DesignTable,
    measurement: Measurement,
    references: Sequence[ReferencePlan],
    place: Place,
) -> tuple[Series, ...]:
    if said.keep is not None:
        plans = {p.name: p for p in references}
        return plans[
            naming.known(said.keep, plans, place.key("keep"), "reference plan")
        ].series
    if said.keep_readings is None:
        return ()
    from pkm_studies import sources  # pandas takes a second to import

    return tuple(
        sources.from_files([study.folder / said.keep_readings], measurement).series
    )


def _free(said: DesignTable, measurement: Measurement, place: Place) -> Ranges:
    if said.polish is None:
        return {}
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for setup, table in said.polish.free.items():
        chosen = measurement.setups[
            naming.known(setup, measurement.setups, place.key(setup))
        ]
        known = {s.name: s.unit for s in chosen.instrument.settings} | dict.fromkeys(
            ("tool_x", "tool_y", "tool_z"), "m"
        )
        found[setup] = {}
        for key, ends in table.items():
            name, unit = quantities.split(key, known, place.key(setup))
            found[setup][name] = (
                float(units.to_si(ends[0], unit)),
                float(units.to_si(ends[1], unit)),
            )
    return found


# -- grids -----------------------------------------------------------------------------


def candidates(
    study: Study, measurement: Measurement
) -> tuple[tuple[Series, ...], dict[str, int], tuple[str, ...]]:
    """A series for each [[design.candidates]]; {reason: candidates refused}; what was
    left out, in words.
    """
    if study.design is None:
        return (), {}, ()
    made: list[Series] = []
    refused: dict[str, int] = {}
    warnings: list[str] = []
    for i, table in enumerate(study.design.candidates):
        place = study.place.key("design").key("candidates").item(i)
        naming.known(table.setup, measurement.setups, place.key("setup"))
        series, lost = grids.grid(table, measurement, place, strict=False)
        if lost:
            refused["cannot hold their reading"] = (
                refused.get("cannot hold their reading", 0) + lost
            )
            warnings.append(
                f"{place.field}: {lost} of {lost + len(series)} poses are left out,"
                f" because {table.setup} cannot hold its reading there"
            )
        if study.design.limits is None:
            warnings += _unheld(measurement, series, place)
        else:
            limits, count = study.place.key("design").key("limits"), len(series)
            series, reasons = resolve_limits.limited(
                study.design.limits,
                measurement,
                series,
                limits,
                whole_runs=study.design.whole_runs,
            )
            for reason, number in reasons.items():
                refused[reason] = refused.get(reason, 0) + number
                warnings.append(
                    f"{place.field}: {number} of {count} candidates are left out: they"
                    f" {reason}"
                )
            if study.design.limits.travel_mm is None:
                warnings += _unheld(measurement, series, place)
        made.append(series)
    return tuple(made), refused, tuple(warnings)


def _unheld(measurement: Measurement, series: Series, place: Place) -> list[str]:
    """A warning where an instrument that holds its reading (a ball bar) would not hold
    it at some poses.
    """
    setup = measurement.setups[series.setup]
    if setup.instrument.holds is None:
        return []
    wanted = setup.instrument.holds(setup.settings)
    first = setup.instrument.channels[0]
    found = measurement.readings([series], measurement.nominal)[:: len(setup.sigma)]
    far = int(np.count_nonzero(np.abs(found - wanted) > UNHELD * wanted))
    if not far:
        return []
    span = (
        f"{quantities.told(found.min(), first.unit)} to"
        f" {quantities.told(found.max(), first.unit)}"
    )
    return [
        f"{place.field}: at {far} of {len(found)} poses {setup.name} would read {span},"
        " but it holds "
        f'{quantities.told(wanted, first.unit)}: let one coordinate be "hold", or give'
        " poses that keep it"
    ]


def references(study: Study, measurement: Measurement) -> tuple[ReferencePlan, ...]:
    """The given plans."""
    plans: dict[str, list[Series]] = {}
    for i, table in enumerate(study.design.reference if study.design else []):
        place = study.place.key("design").key("reference").item(i)
        naming.known(table.setup, measurement.setups, place.key("setup"))
        series, _ = grids.grid(table, measurement, place, strict=True)
        plans.setdefault(table.name, []).append(series)
    return tuple(
        ReferencePlan(name=name, series=tuple(series)) for name, series in plans.items()
    )


def circles(
    study: Study,
    table: KappaTable,
    i: int,
    measure: Callable[[Iterable[str]], Measurement],
) -> Circles:
    """The circles of a [[kappa]] table."""
    place = study.place.key("kappa").item(i)
    setups = [s.name for s in study.setup]
    measurement = measure([naming.known(table.setup, setups, place.key("setup"))])
    machine = measurement.machine
    columns = [c.name for c in machine.command]
    if len(table.coordinates) != 1:
        example = quantities.column(columns[0], machine.command[0].unit)
        raise place.error(
            "one range spaces the circles",
            f"give one, as in {example} = {{ from = ..., to = ... }}",
        )
    key, span = next(iter(table.coordinates.items()))
    name, unit = quantities.split(key, grids.wanted(machine), place)
    if table.coordinate is not None and table.coordinate not in columns:
        raise place.key("coordinate").error(
            "no such coordinate", suggest(table.coordinate, columns), table.coordinate
        )
    rest = [c for c in machine.command if c.name not in (name, table.coordinate)]
    if len(rest) != 1 or rest[0].unit != "rad":
        problem = (
            "besides the range and the held coordinate, one angle must be left to run"
            " round"
        )
        raise place.key("coordinate").error(
            problem, f"coordinates are {', '.join(columns)}", table.coordinate or ""
        )
    lower, upper = (float(units.to_si(v, unit)) for v in (span.from_, span.to))
    ends = np.zeros((2, len(columns)))
    ends[:, columns.index(name)] = lower, upper
    ends[:, [k for k, c in enumerate(columns) if c != name]] = [
        machine.home[c] for c in columns if c != name
    ]
    grids.in_workspace(
        machine, ends, {name: key}, place, measurement.setups[table.setup].tool
    )
    return Circles(
        title=table.title or f"{table.setup}: circles over {name}",
        setup=table.setup,
        circles=tuple(table.circles),
        points=tuple(table.points),
        measurement=measurement,
        across=columns.index(name),
        around=columns.index(rest[0].name),
        hold=table.coordinate,
        lower=lower,
        upper=upper,
        place=place,
    )
