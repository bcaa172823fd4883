"""Parameters whose errors have a common cause, as the study states them."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.model.machine import CommonTolerance, Machine
from oed.model.parameter_vector import ParameterVector
from pkm_studies.resolve import lookup
from pkm_studies.study import Study

#: least eigenvalue of a correlation matrix: nearer to 0 one combination has no error left
LEAST = 1e-6


def with_correlation(study: Study, machine: Machine) -> Machine:
    """The machine with the correlations of [[prior.correlated]].

    Raises InputError for names that do not fit, and for correlations that cannot be.
    """
    tables = study.prior.correlated
    if not tables:
        return machine
    place = study.place.key("prior").key("correlated")
    if study.plan is not None:
        raise place.error(
            "the planner of [plan] takes tolerances as independent",
            "remove [plan], or [[prior.correlated]]",
        )
    free = {p.name for p in machine.parameters if p.tolerance > 0.0}
    free -= set(machine.frame)
    groups = []
    for i, table in enumerate(tables):
        at = place.item(i)
        names = [p.name for p in machine.parameters]
        matched = lookup.matching_names(table.parameters, names, at.key("parameters"))
        members = tuple(name for name in matched if name in free)
        if len(members) < 2:
            raise at.key("parameters").error(
                "fewer than two parameters that have a tolerance",
                f"name two or more of {', '.join(sorted(free))}",
                table.parameters,
            )
        groups.append(CommonTolerance(members, table.correlation))
        changed = dataclasses.replace(machine, correlated=tuple(groups))
        matrix = ParameterVector(changed, []).correlation
        if matrix is not None and np.linalg.eigvalsh(matrix)[0] < LEAST:
            raise at.key("correlation").error(
                "no errors have such correlations"
                + (" together with those above" if i else ""),
                f"{len(members)} parameters have one above"
                f" {-1.0 / (len(members) - 1):.3g} and below 1 between all of them",
                table.correlation,
            )
    return dataclasses.replace(machine, correlated=tuple(groups))
