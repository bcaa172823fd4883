"""Section `forecast` of a result: the planned nodes, the measured ones, what is left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from scipy import special

from oed import units
from oed.base import Array, Index
from oed.compensate import InterpolationTable, joint_motion
from oed.forecast import (
    INTERVAL_LEVELS,
    ErrorField,
    Forecast,
    NodeDesign,
    design_nodes,
    fit_error_field,
    forecast_table,
)
from oed.result import ForecastComponent, ForecastSection
from oed.units import quantity
from pkm_studies import describe
from pkm_studies.base import InputError
from pkm_studies.quantities import format_value
from pkm_studies.stages.forecast import files
from pkm_studies.stages.forecast.task import ForecastTask

#: a node is in doubt that is so many standard deviations off what the others predict
DOUBT = 4.5
#: what a table of errors can do, whatever they come from
REPEATS = (
    "the table removes errors that come back at the same command in the same state"
    " (temperature, payload, direction)"
)


def planned(task: ForecastTask) -> tuple[ForecastSection, Array]:
    """The section with the nodes (n, n_dof), SI, to measure."""
    design = design_nodes(
        task.model,
        task.candidates,
        task.table.nodes,
        task.kernel,
        task.sigma,
        task.wanted,
    )
    nodes = task.candidates[design.indices]
    machine = task.kinematics.machine
    mounting, reading = task.seconds
    section = ForecastSection(
        components=_components(task, design),
        reference=task.model.reference,
        nodes=[describe.displayed_command(machine, node) for node in nodes],
        setup=task.setup,
        minutes=(mounting + len(nodes) * reading) / 60.0,
        sentences=[*_plan_section(task, design)],
    )
    return section, nodes


def _components(task: ForecastTask, design: NodeDesign) -> dict[str, ForecastComponent]:
    components = {}
    for k, c in enumerate(task.model.driven):
        unit = units.FINE[c.unit]
        rows = task.model.rows(task.model.command)
        size = task.kernel.size * np.sqrt((rows.local[:, k] ** 2).sum(axis=1).mean())
        expected = size if np.isnan(task.expected[k]) else task.expected[k]
        components[c.name] = ForecastComponent(
            unit=unit,
            expected=units.number(float(expected), unit),
            planned=units.number(float(design.predicted[k]), unit),
        )
    return components


def _plan_section(task: ForecastTask, design: NodeDesign) -> Iterator[str]:
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
        if design.predicted[k] > task.wanted[k]:
            rest = quantity(float(design.predicted[k]), c.unit)
            yield (
                f"{len(design.indices)} nodes are predicted to leave {c.name} {rest}"
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
    command, errors, sigma = files.read_nodes(task, path)
    correctable = task.predicted_errors(command)
    try:
        field = fit_error_field(task.model, command, errors - correctable, sigma)
    except ValueError as error:
        raise InputError(str(error), "measure more nodes", file=str(path)) from error
    forecast = forecast_table(
        field, task.predicted_errors, task.axes, task.table.commands, rng
    )
    node = _node_of_readings(field, command)
    figures = _figures(errors, field, forecast, node)
    sentences = [*section.sentences, *_doubts(task, field, command, node)]
    if check is None:
        sentences += _unseen_waves(task, command)
    else:
        figures |= _checked(task, field, forecast, check, figures)
    if not forecast.grid.is_fine:
        sentences.append(
            f"the table has {len(forecast.joints)} commands, and interpolation in it"
            " costs more than a fifth of what is left: raise `commands`"
        )
    names = list(section.nodes[0])
    components = _add_figures(task, section, figures)
    sentences += _doubtful_sizes(components)
    filled = replace(
        section,
        components=components,
        readings=len(command),
        table=dict(zip(names, forecast.grid.counts, strict=True)),
        places=files.table_places(task.kinematics, forecast),
        corrections=files.table_corrections(task.kinematics, forecast),
        whole=bool(correctable.any()),
        sentences=sentences,
    )
    return filled, files.table_csv(task.kinematics, forecast)


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
        size, unit = f"{c.measured:.3g} {c.unit}", c.unit
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


#: figures (k,) of the components by name, SI
Figures = dict[str, Array]


def _node_of_readings(field: ErrorField, command: Array) -> Index:
    """Number (r,) of the node of each reading; repeats are of one node."""
    count = field.rows.local.shape[1]
    _, node = np.unique(np.round(command, 9), axis=0, return_inverse=True)
    return np.asarray(node.ravel()[field.read // count])


def _figures(
    errors: Array, field: ErrorField, forecast: Forecast, node: Index
) -> Figures:
    component = field.read % errors.shape[1]
    residual, sd = field.left_out(node)
    return {
        "measured": _rms(errors),
        "predicted": forecast.predicted,
        "low": forecast.interval[0],
        "high": forecast.interval[1],
        "left_out": _rms_by(component, residual, errors.shape[1]),
        "left_out_predicted": _rms_by(component, sd, errors.shape[1]),
    }


def _rms_by(component: Index, values: Array, count: int) -> Array:
    parts = [values[component == k] for k in range(count)]
    return np.array([np.sqrt(np.mean(p**2)) if len(p) else np.nan for p in parts])


def _rms(errors: Array) -> Array:
    read = ~np.isnan(errors)
    component = np.nonzero(read)[1]
    return _rms_by(component, errors[read], errors.shape[1])


def _checked(
    task: ForecastTask,
    field: ErrorField,
    forecast: Forecast,
    path: Path,
    figures: Figures,
) -> Figures:
    """What the table leaves at nodes that were not fitted, with their noise.

    Errors there beyond those predicted, as of waves that the fitted nodes do not see,
    widen the predicted `figures`: of n residuals of mean square s, that of the machine is
    within n s / chi2 of n degrees of freedom.
    """
    command, errors, sigma = files.read_nodes(task, path)
    grid = forecast.grid
    table = InterpolationTable(
        tuple(axis.name for axis in grid.axes),
        grid.knots,
        forecast.joints.reshape(*grid.counts, -1),
        grid.turns,
    )
    motion = joint_motion(task.kinematics, command)
    residual = errors + np.einsum("nkq,nq->nk", motion, table.at(command))
    variance = np.diag(field.covariance(command)).reshape(errors.shape) + sigma**2
    count = np.isfinite(residual).sum(axis=0)
    square = np.nansum(residual**2, axis=0)
    upper, lower = (special.chdtri(count, level) for level in INTERVAL_LEVELS)
    widened = {}
    for name, freedom in (("predicted", count), ("low", upper), ("high", lower)):
        beyond = np.maximum(square / freedom - variance.mean(axis=0), 0.0)
        widened[name] = np.sqrt(figures[name] ** 2 + beyond)
    return widened | {
        "checked": _rms(residual),
        "checked_predicted": np.sqrt(variance.mean(axis=0)),
        "checked_max": np.nanmax(np.abs(residual), axis=0),
        "checked_max_before": np.nanmax(np.abs(errors), axis=0),
    }


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


def _doubts(
    task: ForecastTask, field: ErrorField, command: Array, node: Index
) -> Iterator[str]:
    """A sentence on each node that the others contradict."""
    k = len(task.model.driven)
    residual, sd = field.left_out(node)
    pull = np.abs(residual / sd)
    for worst in np.flatnonzero(pull > DOUBT):
        row, component = divmod(int(field.read[worst]), k)
        pose = describe.displayed_command(task.kinematics.machine, command[row])
        pose_text = ", ".join(f"{name} = {value:.6g}" for name, value in pose.items())
        yield (
            f"the error in {task.model.driven[component].name} at {pose_text} is"
            f" {pull[worst]:.1f} standard deviations off what the other nodes predict:"
            " measure it again"
        )
