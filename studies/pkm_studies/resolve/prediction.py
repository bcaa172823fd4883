"""Commands over the workspace of a study's machine, and the axes of its box."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from oed import units
from oed.accuracy import Reference
from oed.base import Array, grid_nodes
from oed.compensate import GridAxis
from oed.dataset import MAX_NUMBER, ReadingsColumn
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.resolve import grids
from pkm_studies.resolve.machine import REACH_REMEDY, pose_words, reach_problem
from pkm_studies.study import Study
from pkm_studies.tables import PredictionTable

if TYPE_CHECKING:
    import pandas as pd

# Table [prediction] as commands at which accuracy counts, and what is wanted there; SI.

FROM_THE_SESSION = ("time", "repeat")  #: covariates that place a reading in its session


@dataclasses.dataclass(frozen=True)
class PredictionRequest:
    """What [prediction] requests."""

    table: PredictionTable  #: the table itself
    command: Array  #: (n, n_dof) commands at which accuracy is predicted, SI
    #: values, SI, of covariates that the machine is used at
    states: Mapping[str, Array]


def prediction_request(study: Study, machine: Machine) -> PredictionRequest | None:
    """What [prediction] requests; None without it. Raises InputError."""
    if study.prediction is None:
        return None
    location = study.location.key("prediction")
    grid = grids.grid_commands(study.prediction.coordinates, machine, location)
    command, hold, keys = grid
    if hold is not None:
        problem = "accuracy is predicted without an instrument"
        raise location.key(hold).error(problem, "give values with a unit", "hold")
    grids.check_workspace(machine, command, keys, location)
    return PredictionRequest(study.prediction, command, _states(study))


def check_reach(
    study: Study, request: PredictionRequest, kinematics: Kinematics
) -> None:
    """Raises InputError where the nominal machine cannot reach what is predicted."""
    machine = kinematics.machine
    location = study.location.key("prediction")
    for number, length in enumerate([0.0, *request.table.tools]):
        tool = np.array([0.0, 0.0, length * units.MM])
        field = location.path("tools_mm", number - 1) if number else location
        try:
            kinematics.inverse(machine.with_tool(request.command, tool), tool=tool)
        except AssemblyError as error:
            problem = reach_problem(error, machine)
            raise field.error(problem, REACH_REMEDY) from error


def check_states(study: Study, covariates: pd.DataFrame) -> None:
    """Raises InputError for a state in use that no reading was recorded at."""
    states = {} if study.prediction is None else _states(study)
    for name in states:
        if name not in covariates or covariates[name].isna().all():
            raise study.location.path("prediction", "states").error(
                "no reading was taken at a recorded value of it, so that nothing is known"
                " of what it does",
                "record it in the readings, or leave it out",
                _column(name),
            )


def _states(study: Study) -> dict[str, Array]:
    """Values of the covariates in `states`, SI, by stem. Raises InputError."""
    states = {} if study.prediction is None else study.prediction.states
    location = study.location.path("prediction", "states")
    if states and study.identify.effects == "none":
        raise location.error(
            "only effects differ by the state of the machine",
            'add effects = "catalogue" to [identify], or leave the states out',
        )
    values = {}
    for name, value in states.items():
        column = None
        with contextlib.suppress(units.UnitError):
            column = ReadingsColumn.parse(name)
        if column is None or not _is_covariate(column):
            raise location.key(name).error(
                "no covariate of a readings file with its unit",
                "name one as in the file: payload_N, temp_<body>_C, direction",
            )
        if column.stem in FROM_THE_SESSION:
            raise location.key(name).error(
                "no state that a machine is used at",
                "leave it out: it is as in the session",
            )
        listed = value if isinstance(value, list) else [value]
        if not listed:
            raise location.key(name).error("no value", "state those in use", listed)
        values[column.stem] = column.factor * np.array(listed, dtype=float)
        _check_values(column.stem, values[column.stem], location.key(name), listed)
    return values


def _check_values(
    stem: str, values: Array, location: Location, listed: list[float]
) -> None:
    """Raises InputError for values (n,), SI, that no readings file could have."""
    if stem == "direction" and (np.abs(values) != 1.0).any():
        raise location.error(
            "direction is +1 or -1", "give one of them, or both", listed
        )
    if (np.abs(values) > MAX_NUMBER).any():
        raise location.error("no state is so large", "check its unit", listed)
    if stem == "feed" and (values < 0.0).any():
        raise location.error("a feed is at least 0", "state its size", listed)


def _is_covariate(column: ReadingsColumn) -> bool:
    """Whether a column is a covariate in a unit of its kind."""
    covariate = ReadingsColumn.from_covariate(column.stem)
    return covariate is not None and covariate.unit == column.unit


def _column(covariate: str) -> str:
    column = ReadingsColumn.from_covariate(covariate)
    return covariate if column is None else column.name


def wanted_accuracy(study: Study, machine: Machine) -> dict[str, float]:
    """Wanted rms error by component, SI, if any. Raises InputError for other components."""
    if study.prediction is None:
        return {}
    unit_of = {c.name: c.unit for c in machine.components}
    location = study.location.path("prediction", "wanted")
    return quantities.read_values(study.prediction.wanted, unit_of, location)


N_PLACES = 5  #: places along a coordinate of the workspace where the study names none


@dataclasses.dataclass(frozen=True)
class StudyWorkspace:
    """Where a study's machine is used: as [prediction] says, else all over its workspace."""

    study: Study
    kinematics: Kinematics

    @property
    def reference(self) -> Reference:
        """Against which errors are stated."""
        table = self.study.prediction
        return "home" if table is None else table.reference

    @cached_property
    def command(self) -> Array:
        """Commands (n, n_dof): those of [prediction], or a grid over the workspace."""
        machine = self.kinematics.machine
        prediction = prediction_request(self.study, machine)
        if prediction is not None:
            return prediction.command
        return _reachable(self.kinematics, _lattice(machine))

    @cached_property
    def regular(self) -> Array:
        """Those of `command` at which every pose component has an error."""
        return self.regular_at(self.kinematics, self.command)

    @staticmethod
    def regular_at(kinematics: Kinematics, command: Array) -> Array:
        """Commands (n, n_dof) at which every pose component has an error: no tilt is zero."""
        slopes = kinematics.error_components_jacobian(command)
        is_regular = np.isfinite(slopes).all(axis=(1, 2))
        return command[is_regular]

    @property
    def axes(self) -> tuple[GridAxis, ...]:
        """Axes of the box of the commands of [prediction], or of the workspace.

        Accuracy that is zeroed at home needs the corrections of home: the box reaches it.
        """
        machine = self.kinematics.machine
        prediction = prediction_request(self.study, machine)
        if prediction is None:
            return GridAxis.box_axes(machine, _lattice(machine))
        axes = GridAxis.box_axes(machine, prediction.command)
        if prediction.table.reference != "home":
            return axes
        pairs = zip(axes, machine.home_command, strict=True)
        return tuple(axis.reaching(float(location)) for axis, location in pairs)

    def intermediate_commands(self, count: int) -> Array:
        """At most `count` further commands (m, n_dof), spread evenly between `regular`.

        They are within half a diagonal of the grid from one of these, so that they stay in
        the workspace whatever its shape.
        """
        command = self.regular
        low, size = command.min(axis=0), np.ptp(command, axis=0)
        varied = size > 0.0
        dimensions = int(varied.sum())
        if not dimensions or len(command) < 2:
            return command[:0]
        grid = (command - low)[:, varied] / size[varied]
        from scipy import spatial  # loaded by what asks for poses between nodes alone
        from scipy.stats import qmc

        tree = spatial.KDTree(grid)
        spacing = float(tree.query(grid, k=2)[0][:, 1].max())
        # without its first point, which is a corner
        points = qmc.Halton(dimensions, scramble=False).random(count + 1)[1:]
        near = tree.query(points)[0] <= 0.5 * np.sqrt(dimensions) * spacing
        if not near.any():
            return command[:0]
        further = np.repeat(command[:1], int(near.sum()), axis=0)
        further[:, varied] = low[varied] + size[varied] * points[near]
        return self.regular_at(self.kinematics, _reachable(self.kinematics, further))


def _lattice(machine: Machine) -> Array:
    """Commands (n, n_dof) over the workspace, whether in reach or not."""
    knots = tuple(np.linspace(c.lower, c.upper, N_PLACES) for c in machine.command)
    return grid_nodes(knots)


def _reachable(kinematics: Kinematics, command: Array) -> Array:
    while len(command):
        try:
            kinematics.inverse(command)
        except AssemblyError as error:
            command = np.delete(command, error.indices, axis=0)
        else:
            return command
    return kinematics.machine.home_command[None]


N_TRIED = 3  #: values of each coordinate at which the workspace is tried

MAX_TRIED = 729  #: most poses that are tried


def unreachable(kinematics: Kinematics) -> str | None:
    """A sentence on poses, of corners and middles, that joints do not reach; or None."""
    machine = kinematics.machine
    ends = [(c.lower, c.upper) for c in machine.command]
    count = N_TRIED if N_TRIED ** len(ends) <= MAX_TRIED else N_TRIED - 1
    axes = [
        np.linspace(low, high, count) if np.isfinite([low, high]).all() else [home]
        for (low, high), home in zip(ends, machine.home_command, strict=True)
    ]
    command = np.array(list(itertools.product(*axes)))
    why = "cannot be reached"
    try:
        _, q = kinematics.inverse(command)
    except AssemblyError as error:
        rows = error.indices
    else:
        outside = machine.joints_out_of_range(q)
        rows = np.unique([row for row, *_ in outside])
        why = "need joints beyond their ranges"
    if not rows.size:
        return None
    return (
        f"{rows.size} of {len(command)} poses at the ends and middles of the workspace"
        f" {why}, the first at {pose_words(machine, command[rows[0]])}"
    )
