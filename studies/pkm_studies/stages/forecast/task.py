"""Table [forecast] as the kernel's objects: workspace, candidates, noise; SI."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.accuracy import driven_errors
from oed.base import Array, grid_nodes
from oed.compensate import GridAxis, box_axes
from oed.forecast import JointErrors, Kernel, expected_kernel, joint_size
from oed.instrument import Setup
from oed.mechanism import AssemblyError, Kinematics
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.resolve import ResolvedStudy
from pkm_studies.tables import ForecastTable

#: places at which errors count, drawn evenly over the box of the workspace
PLACES = 256
#: candidates along each axis, by the number of axes; further ones have the last
CANDIDATES = (41, 11, 6, 4)
#: most candidates; more are drawn among
MOST = 250
#: candidates round a full turn
ROUND = 12
#: names of an instrument's channel that reads the error of a component
CHANNELS = ("{}", "d{}", "read_{}")


@dataclasses.dataclass(frozen=True)
class EstimatedParameters:
    """Identified parameters (np,) and their covariance (np, np), SI."""

    values: Array
    covariance: Array


@dataclasses.dataclass(frozen=True, eq=False)
class ForecastTask:
    """What [forecast] asks for.

    table                    as written
    model                    error rows over places of the workspace
    axes                     of the controller's table
    candidates               (n, n_dof) nodes to choose from, SI
    expected, sigma, wanted  (k,) of the driven components, SI; NaN where none is wanted
    setup                    that measures
    seconds                  time to mount it, and of one reading
    knowledge                what was identified
    """

    table: ForecastTable
    model: JointErrors
    axes: tuple[GridAxis, ...]
    candidates: Array
    expected: Array
    sigma: Array
    wanted: Array
    setup: str
    seconds: tuple[float, float]
    knowledge: EstimatedParameters | None

    @property
    def kinematics(self) -> Kinematics:
        """Of the machine."""
        return self.model.kinematics

    @property
    def kernel(self) -> Kernel:
        """The kernel before any reading."""
        rows = self.model.rows(self.model.command)
        errors = np.broadcast_to(self.expected, rows.local.shape[:2])
        return expected_kernel(joint_size(rows, errors), rows.positions.shape[1])

    def predicted_errors(self, command: Array) -> Array:
        """Errors (n, k) of the nodes that the parameters predict, SI.

        Zero where the controller compensates what was identified.
        """
        has_estimate = self.table.compensated and self.kinematics.controller is None
        if self.knowledge is None or has_estimate:
            return np.zeros((len(command), len(self.expected)))
        machine = self.kinematics.machine
        errors = driven_errors(
            self.kinematics, command, self.knowledge.values, self.model.reference
        )
        return errors[:, [c.compensatable for c in machine.components]]


def forecast_task(
    resolved: ResolvedStudy,
    knowledge: EstimatedParameters | None,
    rng: np.random.Generator,
) -> ForecastTask:
    """What [forecast] asks for. Raises InputError for what it misstates or lacks."""
    study, where = resolved.study, resolved.prediction
    if study.forecast is None:
        raise study.location.key("forecast").error(
            "the study does not say what calibration leaves",
            "add [forecast] with expected = { z_um = 60 }",
        )
    if where is None:
        raise study.location.key("prediction").error(
            "the study does not say where accuracy counts",
            "add [prediction] with a workspace, see `oed schema study`",
        )
    location = study.location.key("forecast")
    reference = where.table.reference
    if reference == "best_fit":
        raise (
            study.location.key("prediction")
            .key("reference")
            .error(
                "a table cannot align the machine",
                'give "home" or "absolute"',
                reference,
            )
        )
    kinematics = resolved.measurement.kinematics
    axes = box_axes(kinematics.machine, where.command)
    spread = np.zeros((len(kinematics.machine.parameters), 0))
    if knowledge is not None:
        values, vectors = np.linalg.eigh(knowledge.covariance)
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
    model = JointErrors(
        kinematics, _reachable(kinematics, _places(axes, rng)), reference, spread
    )
    setup = _setup(resolved, study.forecast, location)
    expected = _component_values(
        model, study.forecast.expected, location.key("expected")
    )
    wanted = _component_values(model, study.forecast.wanted, location.key("wanted"))
    if np.isnan(expected).all():
        raise location.key("expected").error("it is empty", "name a driven component")
    measurement = resolved.measurement_with([setup.name])
    return ForecastTask(
        table=study.forecast,
        model=model,
        axes=axes,
        candidates=_reachable(kinematics, _candidates(axes, rng)),
        expected=expected,
        sigma=_sigma(model, study.forecast, setup, location.key("sigma")),
        wanted=wanted,
        setup=setup.name,
        seconds=(
            setup.instrument.cost.setup,
            measurement.reading_seconds(setup.name),
        ),
        knowledge=knowledge,
    )


def _setup(resolved: ResolvedStudy, table: ForecastTable, location: Location) -> Setup:
    """The set-up that measures. Raises InputError for one that is not there."""
    if not table.setup:
        return next(iter(resolved.setups.values()))
    if table.setup not in resolved.setups:
        names = ", ".join(resolved.setups)
        field = location.key("setup")
        raise field.error("no such set-up", f"name one of {names}", table.setup)
    return resolved.setups[table.setup]


def _component_values(
    model: JointErrors, table: dict[str, float], location: Location
) -> Array:
    """Values (k,) of the driven components, SI; NaN where none is stated."""
    unit_of = {c.name: c.unit for c in model.driven}
    values = quantities.read_values(table, unit_of, location)
    return np.array([values.get(name, np.nan) for name in unit_of])


def _sigma(
    model: JointErrors, table: ForecastTable, setup: Setup, location: Location
) -> Array:
    """Noise (k,) of a measured error, SI: as stated, else of the set-up's channel."""
    sigma = _component_values(model, table.sigma, location)
    channels = [channel.name for channel in setup.instrument.channels]
    by_channel = dict(zip(channels, setup.sigma, strict=True))
    for k, component in enumerate(model.driven):
        names = [pattern.format(component.name) for pattern in CHANNELS]
        read = [by_channel[name] for name in names if name in by_channel]
        if np.isnan(sigma[k]) and read:
            sigma[k] = read[0]
        if np.isnan(sigma[k]):
            key = quantities.column(component.name, component.unit)
            problem = f"set-up {setup.name} has no channel of {component.name}"
            remedy = f"add {key}, in any unit of its kind, or name another `setup`"
            raise location.error(problem, remedy)
    return sigma


def _places(axes: tuple[GridAxis, ...], rng: np.random.Generator) -> Array:
    """Places (PLACES, n_dof) evenly over the box."""
    from scipy.stats import qmc  # takes half a second to import

    low = np.array([axis.lower for axis in axes])
    high = np.array([axis.upper for axis in axes])
    cube = qmc.LatinHypercube(len(axes), rng=rng).random(PLACES)
    return np.asarray(low + (high - low) * cube)


def _candidates(axes: tuple[GridAxis, ...], rng: np.random.Generator) -> Array:
    """A lattice (n, n_dof) over the box, or a part of it."""
    varied = sum(axis.upper > axis.lower for axis in axes)
    count = CANDIDATES[min(max(varied, 1), len(CANDIDATES)) - 1]
    knots = []
    for axis in axes:
        if axis.turn:
            knots.append(axis.knots(ROUND + 1)[:-1])
        else:
            knots.append(axis.knots(count if axis.upper > axis.lower else 1))
    nodes = grid_nodes(tuple(knots))
    if len(nodes) <= MOST:
        return nodes
    return nodes[rng.choice(len(nodes), MOST, replace=False)]


def _reachable(kinematics: Kinematics, command: Array) -> Array:
    """The commands (n, n_dof) that the machine reaches and whose errors have a meaning."""
    slope = JointErrors(kinematics, command, "absolute", np.zeros((0, 0)))
    command = command[slope.meaningful(command).all(axis=1)]
    try:
        kinematics.inverse(command)
    except AssemblyError as error:
        rest = np.delete(command, error.indices, axis=0)
        if not len(rest):
            raise
        return _reachable(kinematics, rest)
    return command
