"""Which readings are fitted, held out or simulated, and which set-ups they use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from oed.instrument import Setup
from oed.measurement import Measurement, Series
from pkm_studies import quantities
from pkm_studies.resolve import lookup
from pkm_studies.resolve.design import DesignRequest
from pkm_studies.resolve.grids import ReferencePlan
from pkm_studies.study import Study

if TYPE_CHECKING:
    from oed.dataset import Dataset


def used_setups(
    study: Study,
    candidates: Sequence[Series],
    design: DesignRequest | None,
    references: Sequence[ReferencePlan],
    setups: Mapping[str, Setup],
) -> Iterable[str]:
    """Set-ups of candidates and readings; without both, of reference plans, or all.

    A set-up that only [[kappa]] or a reference plan names stays out.
    """
    used = {s.setup for s in candidates}
    if candidates and design is not None:
        used |= {s.setup for s in design.retained}
    if study.readings is not None:
        recorded = not study.readings.simulate
        used |= set(study.readings.fit or (setups if recorded else ()))
        used |= set(study.readings.predict)
    return used or {name for plan in references for name in plan.setups} or setups


def reading_roles(
    study: Study, setups: Mapping[str, Setup]
) -> tuple[tuple[str, ...] | None, tuple[str, ...]]:
    """Set-ups whose readings are fitted (None: all others), and those held out."""
    if study.readings is None:
        return None, ()
    location = study.location.key("readings")
    fit, predict = study.readings.fit, study.readings.predict
    for field, names in (("fit", fit or []), ("predict", predict)):
        for i, name in enumerate(names):
            lookup.known_name(name, setups, location.key(field).item(i))
    both = set(fit or ()) & set(predict)
    if both:
        raise location.key("predict").error(
            f"{min(both)} is fitted as well", "name each set-up in fit or in predict"
        )
    if fit is not None and not fit:
        raise location.key("fit").error(
            "the list is empty", "name the set-ups to fit, or leave fit out"
        )
    return (None if fit is None else tuple(fit)), tuple(predict)


def true_parameters(study: Study, measurement: Measurement) -> dict[str, float]:
    """Parameters of the virtual machine, SI, that the study states.

    A set-up's unknowns stand in a table with the set-up's name.
    """
    if study.readings is None:
        return {}
    location = study.location.key("readings").key("truth")
    common, special = quantities.split_tables(study.readings.truth)
    unit_of = {p.name: p.unit for p in measurement.parameters}
    truth = quantities.read_values(common, unit_of, location)
    for name, table in special.items():
        field_location = location.key(name)
        setup = measurement.setups[
            lookup.known_name(name, measurement.setups, field_location)
        ]
        unit_of = {n.name: n.unit for n in setup.nuisances}
        values = quantities.read_values(table, unit_of, field_location)
        truth |= {f"{name}.{key}": value for key, value in values.items()}
    return truth


def check_stages(study: Study, measurement: Measurement) -> None:
    """Raises InputError for an identification stage that frees no parameter."""
    location = study.location.key("identify").key("stages")
    for i, stage in enumerate(study.identify.stages):
        if not lookup.matching_names(stage, measurement.names, location.item(i)):
            raise location.item(i).error(
                "the list is empty", 'name parameters or patterns: ["*"] frees all'
            )


def readings_dataset(
    study: Study, measurement: Measurement, readings: Sequence[Path] | None
) -> Dataset | None:
    """The readings: files given to the command, files of the study, or its source."""
    table = study.readings
    if readings is None and table is not None and not table.simulate:
        from pkm_studies import sources

        return sources.readings(table, study, measurement)
    if readings:
        from pkm_studies import sources

        return sources.read_files(readings, measurement)
    return None
