"""The accuracy that a study wants of each component: [prediction] wanted."""

from __future__ import annotations

from oed.model.machine import Machine
from pkm_studies.resolve import quantities
from pkm_studies.study import Study


def wanted_accuracy(study: Study, machine: Machine) -> dict[str, float]:
    """Wanted rms error by component, SI; empty where none is stated.

    Raises InputError for a component that the machine does not have.
    """
    if study.prediction is None:
        return {}
    known = {c.name: c.unit for c in machine.components}
    place = study.place.key("prediction").key("wanted")
    return quantities.read_values(study.prediction.wanted, known, place)
