"""What [design] requests: interest, wanted accuracy, retained readings, free settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import units
from oed.base import Array
from oed.design import CRITERIA, QuotaSet
from oed.measurement import Measurement, Series
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.resolve import command_ranges, lookup, quotas
from pkm_studies.resolve.grids import ReferencePlan
from pkm_studies.study import Study
from pkm_studies.tables import DesignTable

#: remedy for what needs prior tolerances
USE_PRIOR = 'write scaling = "tolerance" and prior = true'

CommandRanges = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class DesignRequest:
    """What [design] means to the kernel, in SI.

    interest         names of the parameters that Ds judges
    combination      coefficients of criterion c, by parameter
    accuracy         wanted accuracy that scales I and G, by component; the others do
                     not count
    least_distance   (n_dof,) least distance of two readings along each command
                     coordinate, 0 where there is none; None: no such rule
    retained         readings that are part of the plan already
    free_ranges      what polishing may move: set-up -> setting or tool coordinate ->
                     lowest and highest value
    quotas           numbers of readings from selections of the candidates
    """

    interest: tuple[str, ...]
    combination: Mapping[str, float]
    accuracy: Mapping[str, float]
    least_distance: Array | None
    retained: tuple[Series, ...]
    free_ranges: CommandRanges
    quotas: QuotaSet | None


def design_request(
    study: Study,
    measurement: Measurement,
    references: Sequence[ReferencePlan],
    candidates: Sequence[Series],
) -> DesignRequest | None:
    """What [design] requests; None without it. `measurement` holds all set-ups.

    Raises InputError for fields that contradict each other or do not fit the machine.
    """
    table = study.design
    if table is None:
        return None
    location = study.location.key("design")
    _check_fields(study, table, location)
    return DesignRequest(
        interest=_interest(table, measurement, location.key("interest")),
        combination=_combination(table, measurement, location.key("combination")),
        accuracy=_accuracy(table, measurement, location.key("accuracy")),
        least_distance=_least_distance(table, measurement, location.key("apart")),
        retained=_retained(study, table, measurement, references, location),
        free_ranges=_free_ranges(
            table, measurement, location.key("polish").key("free")
        ),
        quotas=quotas.quota_set(table, measurement, candidates, location),
    )


# -- fields that need each other -------------------------------------------------------


def _check_fields(study: Study, table: DesignTable, location: Location) -> None:
    _check_criteria(study, table, location)
    _check_prior(table, location)
    if table.branch_nodes:
        _check_branching(table, location)
    _check_method(table, location)
    if table.how_many is not None:
        _check_needs(study, table, "I", location.key("how_many"))
    if table.polish is not None and table.polish.enabled:
        _check_polish(study, table, location.key("polish"))
    if table.keep is not None and table.keep_readings is not None:
        raise location.key("keep").error(
            "keep_readings is given as well", "keep one of the two", table.keep
        )


def _check_polish(study: Study, table: DesignTable, location: Location) -> None:
    polished = CRITERIA.polished
    if table.judged_by not in polished:
        raise location.error(
            f"criterion {table.judged_by} has no gradient to polish along",
            f"take one of {', '.join(polished)}, or leave polishing out",
        )
    if study.machine.controller is not None:
        raise location.error(
            "polishing moves poses of a controller with nominal numbers",
            "leave polishing out: [machine] controller holds others",
        )


def _check_criteria(study: Study, table: DesignTable, location: Location) -> None:
    for name in table.compound:
        field_location = location.key("compound").key(name)
        lookup.known_name(name, CRITERIA.plan_names, field_location, "criterion")
    for i, name in enumerate(table.compare):
        field_location = location.key("compare").item(i)
        lookup.known_name(name, CRITERIA.plan_names, field_location, "criterion")
    if table.compound and table.criterion != "D":
        raise location.key("compound").error(
            "a criterion is given as well", "keep criterion or compound"
        )
    if table.prior and table.scaling != "tolerance":
        raise location.key("prior").error(
            "tolerances enter in their own unit",
            'write scaling = "tolerance" as well',
        )
    field = "compound" if table.compound else "criterion"
    for name in table.criteria:
        _check_needs(study, table, name, location.key(field))
    for name in table.compare:
        _check_needs(study, table, name, location.key("compare"))


def _check_prior(table: DesignTable, location: Location) -> None:
    """Raises InputError for fields that make sense only with prior tolerances."""
    if table.prior:
        return
    if table.robust is not None:
        problem = "without tolerances, not all drawn machines see the same directions"
        raise location.key("robust").error(problem, USE_PRIOR)
    if table.setups_max is not None:
        problem = (
            "each set-up adds unknown parameters: without tolerances, fewer set-ups"
            " always leave fewer"
        )
        raise location.key("setups_max").error(problem, USE_PRIOR, table.setups_max)


def _check_branching(table: DesignTable, location: Location) -> None:
    """Raises InputError for fields that a tree's bound does not hold under."""
    nodes, location = table.branch_nodes, location.key("branch_nodes")
    smooth = CRITERIA.smooth
    rough = [name for name in table.criteria if name not in smooth]
    if rough:
        problem = f"branch and bound needs a smooth criterion, not {', '.join(rough)}"
        remedy = f"take one of {', '.join(smooth)}, or leave branch_nodes out"
        raise location.error(problem, remedy, nodes)
    for name, value in _given_rules(table).items():
        if value:
            problem = f"branch and bound does not know the rule {name}"
            raise location.error(problem, f"leave branch_nodes or {name} out", nodes)


def _given_rules(table: DesignTable) -> Mapping[str, bool]:
    """Rules besides the number of readings, and whether they are given."""
    return {
        "budget_min": table.budget_min is not None,
        "setups_max": table.setups_max is not None,
        "apart": bool(table.apart),
        "quota": bool(table.quota),
        "equal": table.equal is not None,
        "robust": table.robust is not None,
    }


def _check_method(table: DesignTable, location: Location) -> None:
    """Raises InputError for fields that do not go with the method."""
    if table.method == "exchange":
        if table.solver is not None:
            raise location.key("solver").error(
                "only weights have a solver",
                'write method = "relaxed", or leave solver out',
                table.solver,
            )
        return
    field_location = location.key("method")
    weighed = CRITERIA.weighed
    if table.judged_by not in weighed:
        raise field_location.error(
            f"weights are for {', '.join(weighed)}, not {table.judged_by}",
            f"take one of {', '.join(weighed)}, or leave method out",
            table.method,
        )
    fields = {
        **_given_rules(table),
        "branch_nodes": table.branch_nodes > 0,
        "compare": bool(table.compare),
        "how_many": table.how_many is not None,
    }
    for name, value in fields.items():
        if value:
            problem = f"weights do not go with {name}"
            raise field_location.error(
                problem, f"leave method or {name} out", table.method
            )


def _check_needs(
    study: Study, table: DesignTable, name: str, location: Location
) -> None:
    """Raises InputError where a criterion lacks its workspace, prior or combination."""
    needs = CRITERIA[name].needs
    if needs == "accuracy" and study.prediction is None:
        raise location.error(
            "accuracy over which workspace?", "add a [prediction] table", name
        )
    if needs == "accuracy" and not table.prior:
        problem = "accuracy depends on the tolerances of what no reading sees"
        raise location.error(problem, USE_PRIOR, name)
    if needs == "combination" and not table.combination:
        raise location.error(
            "which combination?", "add combination = { PARAMETER = 1.0 }", name
        )


# -- what is judged --------------------------------------------------------------------


def _interest(
    table: DesignTable, measurement: Measurement, location: Location
) -> tuple[str, ...]:
    free = measurement.free_names
    if not table.interest:
        return tuple(name for name in free if "." not in name)
    return tuple(lookup.matching_names(table.interest, free, location))


def _combination(
    table: DesignTable, measurement: Measurement, location: Location
) -> dict[str, float]:
    free = measurement.free_names
    for name in table.combination:
        lookup.known_name(name, free, location.key(name), "parameter")
    if table.combination and not any(table.combination.values()):
        raise location.error("all coefficients are 0", "give one that is not")
    return dict(table.combination)


def _accuracy(
    table: DesignTable, measurement: Measurement, location: Location
) -> dict[str, float]:
    machine = measurement.machine
    unit_of = {c.name: c.unit for c in machine.components}
    if table.accuracy:
        return quantities.read_values(table.accuracy, unit_of, location)
    angle = 1.0 / machine.lever
    return {name: 1.0 if unit == "m" else angle for name, unit in unit_of.items()}


def _least_distance(
    table: DesignTable, measurement: Measurement, location: Location
) -> Array | None:
    if not table.apart:
        return None
    machine = measurement.machine
    values = quantities.read_values(
        table.apart, command_ranges.command_units(machine), location
    )
    return np.array([values.get(c.name, 0.0) for c in machine.command])


def _retained(
    study: Study,
    table: DesignTable,
    measurement: Measurement,
    references: Sequence[ReferencePlan],
    location: Location,
) -> tuple[Series, ...]:
    if table.keep is not None:
        plans = {plan.name: plan for plan in references}
        field_location = location.key("keep")
        return plans[
            lookup.known_name(table.keep, plans, field_location, "reference plan")
        ].series
    if table.keep_readings is None:
        return ()
    from pkm_studies import sources

    path = study.folder / table.keep_readings
    return tuple(sources.read_files([path], measurement).series)


def _free_ranges(
    table: DesignTable, measurement: Measurement, location: Location
) -> CommandRanges:
    if table.polish is None:
        return {}
    ranges: dict[str, dict[str, tuple[float, float]]] = {}
    for name, limits in table.polish.free.items():
        field_location = location.key(name)
        setup = measurement.setups[
            lookup.known_name(name, measurement.setups, field_location)
        ]
        unit_of = {s.name: s.unit for s in setup.instrument.settings}
        unit_of |= dict.fromkeys(("tool_x", "tool_y", "tool_z"), "m")
        ranges[name] = {}
        for key, (low, high) in limits.items():
            moved, unit = quantities.split_key(key, unit_of, field_location)
            ends = float(units.to_si(low, unit)), float(units.to_si(high, unit))
            ranges[name][moved] = ends
    return ranges
