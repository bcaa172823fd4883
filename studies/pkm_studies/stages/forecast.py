"""Forecast compensation: the nodes to read, their fit, its sentences and its files."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from oed import csv_text, units
from oed.accuracy import driven_errors
from oed.base import Array, grid_nodes
from oed.compensate import GridAxis, commands_of_added
from oed.dataset import commented
from oed.forecast import JointErrors
from oed.instrument import Setup
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Component
from oed.result import ForecastComponent, ForecastSection
from oed.units import quantity
from pkm_studies import csv_table, describe, quantities
from pkm_studies.base import InputError, Location, Stream
from pkm_studies.csv_table import CsvTable
from pkm_studies.quantities import column, display_unit, format_value
from pkm_studies.resolve import ResolvedStudy, readings_comments
from pkm_studies.stages.run_state import Fitted, StateT
from pkm_studies.tables import ForecastTable


# The section `forecast` in sentences, for the terminal.
def forecast_sentences(section: ForecastSection | None) -> Iterator[str]:
    """What to measure, and what the table leaves where it is measured."""
    if section is None:
        return
    if not section.readings:
        yield (
            f"Measure the errors at {len(section.nodes)} nodes with set-up"
            f" {section.setup}: {section.minutes:.0f} min."
        )
    yield from figures(section)
    for name, c in section.components.items():
        if c.checked is not None and c.checked_max is not None:
            yield (
                f"{name}, at nodes that were not fitted: rms {c.checked:.3g} {c.unit}"
                f" (predicted {c.checked_predicted:.3g} {c.unit}), largest"
                f" {c.checked_max:.3g} {c.unit} (without the table"
                f" {c.checked_max_before:.3g} {c.unit})."
            )
    for sentence in section.sentences:
        yield f"{sentence[0].upper()}{sentence[1:]}."


def figures(section: ForecastSection | None) -> Iterator[str]:
    """What is left of each component, as predicted."""
    if section is None:
        return
    for name, c in section.components.items():
        if c.predicted is None:
            yield (
                f"{name}: of {c.expected:.3g} {c.unit} rms, interpolation between the nodes"
                f" is predicted to leave {c.planned:.3g} {c.unit}."
            )
        elif c.measured is None:
            yield f"{name}: not measured; {c.predicted:.3g} {c.unit} rms are predicted."
        else:
            yield (
                f"{name}: of {c.measured:.3g} {c.unit} rms at the nodes, the table is predicted"
                f" to leave {c.predicted:.3g} {c.unit} (95 %: {c.low:.3g} to {c.high:.3g} {c.unit})."
                f" Each node, predicted by all others: {c.left_out:.3g} {c.unit} off; expected are"
                f" {c.left_out_predicted:.3g} {c.unit}."
            )


# Table [forecast] as the kernel's objects: workspace, candidates, noise; SI.

#: places at which errors count, drawn evenly over the box of the workspace
WORKSPACE_PLACES = 256
#: candidates along each axis, by the number of axes; further ones have the last
CANDIDATES = (41, 11, 6, 4)
MAX_CANDIDATES = 250  #: most candidates; more are drawn among
CANDIDATES_PER_TURN = 12  #: candidates round a full turn
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

    expected, sigma, wanted  (k,) of the driven components, SI; NaN where none is wanted
    """

    table: ForecastTable  #: as written
    model: JointErrors  #: error rows over places of the workspace
    axes: tuple[GridAxis, ...]  #: of the controller's table
    candidates: Array  #: (n, n_dof) nodes to choose from, SI
    expected: Array
    sigma: Array
    wanted: Array
    setup: str  #: that measures
    seconds: tuple[float, float]  #: time to mount it, and of one reading
    knowledge: EstimatedParameters | None  #: what was identified

    @property
    def kinematics(self) -> Kinematics:
        """Of the machine."""
        return self.model.kinematics

    def predicted_errors(self, command: Array) -> Array:
        """Predicted errors (n, k) of the nodes, SI; zero where they are compensated."""
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
        raise study.location.path("prediction", "reference").error(
            "a table cannot align the machine", 'give "home" or "absolute"', reference
        )
    kinematics = resolved.measurement.kinematics
    axes = GridAxis.box_axes(kinematics.machine, where.command)
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
        seconds=(setup.instrument.cost.setup, measurement.reading_seconds(setup.name)),
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
    cube = qmc.LatinHypercube(len(axes), rng=rng).random(WORKSPACE_PLACES)
    return np.asarray(low + (high - low) * cube)


def _candidates(axes: tuple[GridAxis, ...], rng: np.random.Generator) -> Array:
    """A lattice (n, n_dof) over the box, or a part of it."""
    varied = sum(axis.upper > axis.lower for axis in axes)
    count = CANDIDATES[min(max(varied, 1), len(CANDIDATES)) - 1]
    knots = []
    for axis in axes:
        if axis.turn:
            knots.append(axis.knots(CANDIDATES_PER_TURN + 1)[:-1])
        else:
            knots.append(axis.knots(count if axis.upper > axis.lower else 1))
    nodes = grid_nodes(tuple(knots))
    if len(nodes) <= MAX_CANDIDATES:
        return nodes
    return nodes[rng.choice(len(nodes), MAX_CANDIDATES, replace=False)]


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


# Section `forecast` of a result: the planned nodes, the measured ones, what is left.

#: a node is in doubt that is so many standard deviations off what the others predict
DOUBTFUL_NODE_DEVIATIONS = 4.5
#: what a table of errors can do, whatever they come from
REPEATS = (
    "the table removes errors that repeat at the same command in the same state"
    " (temperature, payload, direction)"
)


def planned(task: ForecastTask) -> tuple[ForecastSection, Array]:
    """The section with the nodes (n, n_dof), SI, to measure."""
    design = task.model.plan_nodes(
        task.candidates, task.table.nodes, task.expected, task.sigma, task.wanted
    )
    nodes = task.candidates[design.indices]
    machine = task.kinematics.machine
    mounting, reading = task.seconds
    components = {}
    for k, c in enumerate(task.model.driven):
        unit = units.FINE[c.unit]
        components[c.name] = ForecastComponent(
            unit=unit,
            expected=units.number(float(design.expected[k]), unit),
            planned=units.number(float(design.predicted[k]), unit),
        )
    section = ForecastSection(
        components=components,
        reference=task.model.reference,
        nodes=[describe.displayed_command(machine, node) for node in nodes],
        setup=task.setup,
        minutes=(mounting + len(nodes) * reading) / 60.0,
        sentences=[*_plan_section(task, len(nodes), design.predicted)],
    )
    return section, nodes


def _plan_section(task: ForecastTask, count: int, predicted: Array) -> Iterator[str]:
    """What the plan rests on, and what it does not reach."""
    if task.model.reference == "home":
        yield (
            "errors are against home: zero the instrument there, or subtract the errors"
            " that it reads there"
        )
    against_home = task.model.reference == "home"
    yield f"{REPEATS}, and adds nothing at home" if against_home else REPEATS
    undriven = [
        c.name for c in task.kinematics.machine.components if not c.compensatable
    ]
    if undriven:
        yield f"no joint drives {', '.join(undriven)}: the table leaves their errors"
    for k, c in enumerate(task.model.driven):
        if predicted[k] > task.wanted[k]:
            rest = quantity(float(predicted[k]), c.unit)
            yield (
                f"{count} nodes are predicted to leave {c.name} {rest}"
                f" rms, more than the wanted {quantity(float(task.wanted[k]), c.unit)}:"
                " allow more `nodes`, or measure more accurately"
            )


def measured(
    task: ForecastTask,
    section: ForecastSection,
    path: Path,
    check: Path | None,
    rng: np.random.Generator,
) -> tuple[ForecastSection, str]:
    """The section with the field of measured nodes, and the controller's table as CSV.

    path   file of the nodes
    check  file of nodes that are not fitted

    Raises InputError for files that cannot be used.
    """
    command, errors, sigma = read_nodes(task, path)
    correctable = task.predicted_errors(command)
    try:
        field = task.model.fit(command, errors - correctable, sigma)
    except ValueError as error:
        raise InputError(str(error), "measure more nodes", file=str(path)) from error
    forecast = field.forecast(
        task.predicted_errors, task.axes, task.table.commands, rng
    )
    residual, sd = field.left_out()
    figures = {
        "measured": _rms(errors),
        "left_out": _rms(residual),
        "left_out_predicted": _rms(sd),
    }
    sentences = [*section.sentences, *_doubts(task, command, residual / sd)]
    if check is None:
        sentences += _unseen_waves(task, command)
    else:
        nodes = read_nodes(task, check)
        forecast, residual, predicted = forecast.checked(*nodes)
        figures |= {
            "checked": _rms(residual),
            "checked_predicted": predicted,
            "checked_max": np.nanmax(np.abs(residual), axis=0),
            "checked_max_before": np.nanmax(np.abs(nodes[1]), axis=0),
        }
    low, high = forecast.interval
    figures |= {"predicted": forecast.predicted, "low": low, "high": high}
    if not forecast.grid.is_fine:
        sentences.append(
            f"the table has {len(forecast.joints)} commands, and interpolation in it"
            " costs more than a fifth of what is left: raise `commands`"
        )
    names = list(section.nodes[0])
    components = _add_figures(task, section, figures)
    sentences += _doubtful_sizes(components)
    pairs = zip(task.kinematics.machine.command, forecast.grid.knots, strict=True)
    filled = replace(
        section,
        components=components,
        readings=len(command),
        table=dict(zip(names, forecast.grid.counts, strict=True)),
        places={column(c.name, c.unit): _shown(k, c.unit).tolist() for c, k in pairs},
        corrections=table_corrections(task.kinematics, forecast.joints),
        whole=bool(correctable.any()),
        sentences=sentences,
    )
    text = table_csv(task.kinematics, forecast.grid.commands, forecast.joints)
    return filled, text


def _unseen_waves(task: ForecastTask, command: Array) -> Iterator[str]:
    """The shortest wave along a joint that nodes (n, n_dof) can tell from noise.

    It is twice the distance between neighbours (Nyquist), in the travel of the joint that
    moves most between them.
    """
    nodes = np.unique(np.round(command, 9), axis=0)
    unit = task.kinematics.machine.joints[0].unit
    alike = [joint.unit == unit for joint in task.kinematics.machine.joints]
    joints = task.kinematics.inverse(nodes)[1][:, alike]
    travel = np.abs(joints[:, None] - joints[None]).max(axis=2)
    np.fill_diagonal(travel, np.inf)
    wave = format_value(2.0 * float(np.median(travel.min(axis=1))), unit)
    yield (
        f"waves along a joint that are shorter than {wave}, such as those of a screw's"
        " pitch, look like noise at these nodes, and the predicted error lacks them: read"
        " one line finer, and give it as `check`"
    )


#: factor between the errors of the nodes and those expected from which a unit is in doubt
WRONG_UNIT = 30.0


def _doubtful_sizes(components: dict[str, ForecastComponent]) -> Iterator[str]:
    """Components whose errors are of another size than expected, or too small to map."""
    for name, c in components.items():
        if not c.measured or c.predicted is None:
            continue
        size = f"{c.measured:.3g} {c.unit}"
        unit = c.unit
        if not 1.0 / WRONG_UNIT < c.measured / c.expected < WRONG_UNIT:
            yield (
                f"{name}: the nodes have errors of {size} rms, and {c.expected:.3g} {unit}"
                " are expected: check the unit of the file, or `expected`"
            )
        elif c.predicted >= c.measured:
            yield (
                f"{name}: the table is predicted to leave as much as the nodes have"
                f" ({size}): measure more nodes, or more finely, before you use it"
            )


def _rms(values: Array) -> Array:
    """Rms (k,) of the values (n, k) that are not NaN; NaN where all are."""
    read = [column[~np.isnan(column)] for column in values.T]
    return np.array([np.sqrt(np.mean(r**2)) if len(r) else np.nan for r in read])


def _add_figures(
    task: ForecastTask, section: ForecastSection, figures: Mapping[str, Array]
) -> dict[str, ForecastComponent]:
    """The components with further figures, in their units; none of what was not read."""
    filled = {}
    for k, c in enumerate(task.model.driven):
        component = section.components[c.name]
        values = {
            name: units.number(float(value[k]), component.unit)
            for name, value in figures.items()
            if np.isfinite(value[k])
        }
        filled[c.name] = replace(component, **values)
    return filled


def _doubts(task: ForecastTask, command: Array, pull: Array) -> Iterator[str]:
    """A sentence on each node that others contradict; pull (n, k) residuals over sd."""
    for row, k in np.argwhere(np.abs(pull) > DOUBTFUL_NODE_DEVIATIONS):
        pose = describe.displayed_command(task.kinematics.machine, command[row])
        pose_text = ", ".join(f"{name} = {value:.6g}" for name, value in pose.items())
        yield (
            f"the error in {task.model.driven[k].name} at {pose_text} is"
            f" {abs(pull[row, k]):.1f} standard deviations off what the other nodes"
            " predict: measure it again"
        )


# Files of a forecast: nodes to fill in, nodes as measured, and the controller's table.

NODES, TABLE = "forecast_nodes.csv", "forecast_table.csv"
#: columns of a component's measured error, and of its standard deviation
ERROR, SIGMA = "error_{}_{}", "sigma_{}_{}"
TABLE_DECIMALS = 6  #: decimals of the table, in mm and degrees


def error_columns(components: tuple[Component, ...], pattern: str) -> list[str]:
    """Column of each component."""
    return [pattern.format(c.name, units.FINE[c.unit]) for c in components]


def nodes_csv(task: ForecastTask, nodes: Array) -> str:
    """Nodes (n, n_dof), SI, with empty columns for the measured errors."""
    machine, driven = task.kinematics.machine, task.model.driven
    names = error_columns(driven, ERROR)
    commands = [describe.displayed_command(machine, node) for node in nodes]
    lines = readings_comments(machine, {}, list(commands[0]))
    reference = f"reference: {task.model.reference}"
    about = [
        f"{name}: {component.about or component.name}; {reference}"
        for name, component in zip(names, driven, strict=True)
    ]
    rows = [
        [*(f"{value:.10g}" for value in command.values()), *[""] * len(names)]
        for command in commands
    ]
    header = [*commands[0], *names]
    return commented([*lines, *about]) + csv_text.of_rows([header, *rows])


def read_nodes(task: ForecastTask, path: Path) -> tuple[Array, Array, Array]:
    """Commands (n, n_dof), errors (n, k), NaN where none, and their noise (n, k), SI.

    Raises InputError for a command out of range, a noise that is not positive, and where
    no error was measured.
    """
    machine, driven = task.kinematics.machine, task.model.driven
    table = csv_table.read(path)
    names = list(describe.displayed_command(machine, machine.home_command))
    command = np.column_stack(
        [
            units.to_si(table.numbers(name), display_unit(c.unit))
            for name, c in zip(names, machine.command, strict=True)
        ]
    )
    for j, coordinate in enumerate(task.kinematics.machine.command):
        slack = 1e-6 * (coordinate.upper - coordinate.lower)
        low, high = coordinate.lower - slack, coordinate.upper + slack
        for row in np.flatnonzero((command[:, j] < low) | (command[:, j] > high)):
            remedy = "measure within the machine's range"
            raise table.error(int(row), names[j], "out of the machine's range", remedy)
    errors, sigma = [], []
    pairs = zip(error_columns(driven, ERROR), error_columns(driven, SIGMA), strict=True)
    for k, (error, noise) in enumerate(pairs):
        unit = units.FINE[driven[k].unit]
        errors.append(units.to_si(table.numbers(error, gaps=True), unit))
        sigma.append(_noise(table, noise, unit, float(task.sigma[k])))
    read = np.column_stack(errors)
    if np.isnan(read).all():
        raise InputError(
            "no error was measured", "fill in the columns error_...", file=table.file
        )
    measured = ~np.isnan(read).all(axis=1)
    return command[measured], read[measured], np.column_stack(sigma)[measured]


def _noise(table: CsvTable, name: str, unit: str, usual: float) -> Array:
    """Standard deviation (n,) of each row, SI."""
    if name not in table.header:
        return np.full(len(table), usual)
    values = table.numbers(name, gaps=True)
    for k in np.flatnonzero(values <= 0.0):
        remedy = "give a standard deviation > 0, or leave the cell empty"
        raise table.error(int(k), name, "not positive", remedy)
    return np.asarray(np.where(np.isnan(values), usual, units.to_si(values, unit)))


def table_csv(kinematics: Kinematics, command: Array, joints: Array) -> str:
    """Corrections (n, nq) of the joints and corrected commands at commands (n, n_dof)."""
    machine = kinematics.machine
    corrected = commands_of_added(kinematics, command, joints)
    columns: dict[str, Array] = {}
    for k, c in enumerate(machine.command):
        columns[column(c.name, c.unit)] = _shown(command[:, k], c.unit)
    for name, values in table_corrections(kinematics, joints).items():
        columns[name] = np.array(values)
    for k, c in enumerate(machine.command):
        columns[column(f"corrected_{c.name}", c.unit)] = _shown(corrected[:, k], c.unit)
    rows = (
        [f"{value:.{TABLE_DECIMALS}f}" for value in row]
        for row in zip(*columns.values(), strict=True)
    )
    return commented(_table_comments(kinematics)) + csv_text.of_rows(
        [[*columns], *rows]
    )


def table_corrections(kinematics: Kinematics, joints: Array) -> dict[str, list[float]]:
    """What the table adds to the joints at its nodes, by column."""
    return {
        column(f"correction_{j.name}", j.unit): _shown(values, j.unit).tolist()
        for j, values in zip(kinematics.machine.joints, joints.T, strict=True)
    }


def _table_comments(kinematics: Kinematics) -> Iterator[str]:
    machine = kinematics.machine
    names = list(describe.displayed_command(machine, machine.home_command))
    yield from readings_comments(machine, {}, names)
    yield (
        "correction_...: to add to the joints that the controller has for the command;"
        " interpolate linearly, beyond the grid its border holds"
    )
    yield "corrected_...: the command to send instead, where the joints are out of reach"


def _shown(values: Array, unit: str) -> Array:
    return np.asarray(units.from_si(values, display_unit(unit)))


# The step of forecast compensation: plans its nodes, and fits those that were measured.
def forecast_errors(
    state: StateT,
    knowledge: EstimatedParameters | None = None,
    readings: Path | None = None,
) -> StateT:
    """The state with nodes, and the table of measured ones. Raises InputError."""
    state.progress.stage("forecast")
    study = state.study
    rng = state.rng(Stream.FORECAST)
    if knowledge is None and isinstance(state, Fitted):
        count = len(state.resolved.machine.parameters)
        estimate = state.estimate
        knowledge = EstimatedParameters(
            estimate.theta[:count], estimate.covariance[:count, :count]
        )
    task = forecast_task(state.resolved, knowledge, rng)
    forecast, nodes = planned(task)
    table = task.table
    if readings is None and table.readings:
        readings = study.folder / table.readings
    if readings is None:
        written = {NODES: nodes_csv(task, nodes)}
    else:
        check = study.folder / table.check if table.check else None
        forecast, text = measured(task, forecast, readings, check, rng)
        written = {TABLE: text}
    return state.add_sections(forecast=forecast).replace(forecast_files=written)
