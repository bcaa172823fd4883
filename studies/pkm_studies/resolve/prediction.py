"""Table [prediction] as commands at which accuracy counts, and what is wanted there; SI."""

from __future__ import annotations

import dataclasses

from oed.base.arrays import Array
from oed.model.machine import Machine
from pkm_studies.resolve import grids, quantities
from pkm_studies.study import Study
from pkm_studies.study.tables import PredictionTable


@dataclasses.dataclass(frozen=True)
class PredictionRequest:
    """What [prediction] requests.

    table    the table itself
    command  (n, n_dof) commands at which accuracy is predicted, SI
    """

    table: PredictionTable
    command: Array


def prediction_request(study: Study, machine: Machine) -> PredictionRequest | None:
    """What [prediction] requests; None without it. Raises InputError."""
    if study.prediction is None:
        return None
    place = study.place.key("prediction")
    grid = grids.grid_commands(study.prediction.coordinates, machine, place)
    command, hold, keys = grid
    if hold is not None:
        raise place.key(hold).error(
            "accuracy is predicted without an instrument",
            "give values with a unit",
            "hold",
        )
    grids.check_workspace(machine, command, keys, place)
    return PredictionRequest(study.prediction, command)


def wanted_accuracy(study: Study, machine: Machine) -> dict[str, float]:
    """Wanted rms error by component, SI; empty where none is stated.

    Raises InputError for a component that the machine does not have.
    """
    if study.prediction is None:
        return {}
    known = {c.name: c.unit for c in machine.components}
    place = study.place.key("prediction").key("wanted")
    return quantities.read_values(study.prediction.wanted, known, place)
