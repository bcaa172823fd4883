"""The budget of a machine that is driven by a compensation file: all that it errs by.

The predicted budget holds for exact compensation, with additional axes that take back what
no joint corrects. The file adds what its digits, the controller's model and
interpolation cost, and effects that it does not hold. These are fixed errors of mean
square V_j over the workspace, and the predicted ones have mean 0: the mean squares add
up. Without additional axes the known errors of what no joint corrects join them.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed import units
from oed.accuracy import driven_errors
from oed.base import Array
from oed.compensate import interpolation_errors, joint_errors
from oed.mechanism import AssemblyError
from oed.result import (
    BudgetLine,
    BudgetSection,
    CorrectedSection,
    PredictionSection,
    StudyResult,
)
from oed.verdict import GEOMETRY_ALONE, accuracy_verdicts
from pkm_studies.catalogue import Compensation, ControllerFormat
from pkm_studies.results import advice_on, error_quantities

BUDGET_FILE = "_budget.json"  #: end of the name of the file with the budget
#: names of the lines that a file adds
INTERPOLATION = "interpolation between the commands of the table"
OF_EFFECTS = "interpolation of the effects' tables, at most"
LEFT_OUT = "effects that the file does not hold"

Values = Mapping[str, float]  #: rms errors by pose component, in its fine unit


@dataclasses.dataclass(frozen=True)
class FileLine:
    """A source that the file adds; `rms` of each component that the joints drive."""

    source: str
    kind: str
    rms: Values


@dataclasses.dataclass(frozen=True)
class FileBudget:
    """A budget with the lines of a file, and what it amounts to, in a sentence."""

    section: BudgetSection
    added: Values  #: rms errors that the file adds to the predicted ones, by component
    sentence: str


def complete_budget(
    controller: ControllerFormat, content: Compensation, result: StudyResult
) -> FileBudget | None:
    """The budget with a file's lines, for what joints or axes correct; None without."""
    corrected = result.corrected
    prediction = result.final_prediction
    if prediction is None or prediction.budget is None or controller.joints is None:
        return None
    budget = prediction.budget
    shown = _shown(controller, content, budget)
    lines = [_rounding(controller, content, prediction, shown)]
    if controller.interpolated:
        lines += _interpolation(content, prediction, shown)
    lines += _effect_lines(content, shown)
    added = _mean_square_sum(lines)
    if corrected is not None and not controller.tables:
        lines.append(_left_out(prediction, _geometry_alone(result, corrected), shown))
        if (
            result.controller_mixture is None
        ):  # else the effects are in its predicted errors
            added = _mean_square_sum(lines)
    section = add_lines(budget, lines)
    driven = fine_units(content, driven=True)
    section = msgspec.structs.replace(
        section,
        advice=advice_on(section.lines, section.predicted, driven),
        no_axes=_rms_without_axes(content, prediction, budget, section),
    )
    sent_alone = not (controller.tables and content.tables)
    sentence = _accuracy_sentence(result, section, added, driven, sent_alone)
    axes = _axes_sentence(controller, content, section)
    return FileBudget(section, added, sentence + axes)


def _mean_square_sum(lines: Sequence[FileLine]) -> dict[str, float]:
    """Rms errors of several independent sources, by component."""
    return {
        name: math.hypot(*(line.rms[name] for line in lines)) for name in lines[0].rms
    }


def _accuracy_sentence(
    result: StudyResult,
    section: BudgetSection,
    added: Values,
    driven: Mapping[str, str],
    sent_alone: bool,
) -> str:
    """The error with the file, as a verdict judges it, and with exact compensation.

    Where that counts effects which the budget does not hold, geometry alone beside it.
    """
    limits = dict.fromkeys(driven, math.inf)
    with_file = accuracy_verdicts(result, limits, geometry_sent=sent_alone, added=added)
    exact = accuracy_verdicts(result, limits)
    scopes = ", ".join(dict.fromkeys(v.scope for v in with_file.values()))
    rms = error_quantities({n: v.rms for n, v in with_file.items()}, driven)
    least = error_quantities({n: v.rms for n, v in exact.items()}, driven)
    sentence = (
        f"with this file the predicted rms is {rms}, {scopes};"
        f" exact compensation leaves {least}"
    )
    if scopes == GEOMETRY_ALONE or result.corrected is not None:
        return sentence
    alone = error_quantities(section.predicted, driven)
    return f"{sentence}; geometry alone with this file: {alone}"


def _geometry_alone(result: StudyResult, corrected: CorrectedSection) -> Values:
    """Rms errors with the parameters that are sent, and no effect corrected."""
    mixture = result.controller_mixture
    if mixture is not None and mixture.prediction is not None:
        components = mixture.prediction.components
        return {name: c.after.rms for name, c in components.items()}
    return {name: spread.rms for name, spread in corrected.parameters_only.items()}


def _shown(
    controller: ControllerFormat, content: Compensation, budget: BudgetSection
) -> dict[str, str]:
    """{component: fine unit} of those that the file corrects, where they are predicted."""
    shown = fine_units(content, driven=True)
    if controller.offsets is not None:
        shown |= fine_units(content, driven=False)
    return {name: unit for name, unit in shown.items() if name in budget.predicted}


def _rms_without_axes(
    content: Compensation,
    prediction: PredictionSection,
    budget: BudgetSection,
    section: BudgetSection,
) -> dict[str, float]:
    """Rms of what no joint drives and no axis corrects, by component in its fine unit."""
    undriven = fine_units(content, driven=False)
    unknown = budget.predicted | section.predicted
    predicted = [name for name in undriven if name in unknown]
    if not predicted:
        return {}
    correctable = driven_errors(
        content.kinematics,
        content.command,
        content.identified.values,
        prediction.reference,  # type: ignore[arg-type]
        believed=content.identified.values,
    )
    rms = _rms(content, correctable, {n: undriven[n] for n in predicted})
    return {n: float(np.hypot(rms[n], unknown[n])) for n in predicted}


def _axes_sentence(
    controller: ControllerFormat, content: Compensation, section: BudgetSection
) -> str:
    """What stays of what no joint drives, without and with additional axes."""
    if not section.no_axes:
        return ""
    units_of = {n: fine_units(content, driven=False)[n] for n in section.no_axes}
    without = error_quantities(section.no_axes, units_of)
    sentence = (
        f". No drive of this machine corrects {', '.join(units_of)}: {without} rms"
    )
    if controller.offsets is None:
        return sentence + "; csv and json have columns for additional axes"
    columns = ", ".join(f"{axis.name}_offset" for axis in content.further.axes)
    remaining = error_quantities(section.predicted, units_of)
    return f"{sentence}, and {remaining} with additional axes that take back {columns}"


def add_lines(budget: BudgetSection, added: Sequence[FileLine]) -> BudgetSection:
    """A budget with further lines, of the components that these have."""
    names = list(added[0].rms)
    extra = {n: sum(line.rms[n] ** 2 for line in added) for n in names}
    total = {n: (budget.predicted[n] ** 2 + extra[n]) ** 0.5 for n in names}

    def grown(values: Values) -> dict[str, float]:
        return {n: (values[n] ** 2 + extra[n]) ** 0.5 for n in names}

    lines = [
        msgspec.structs.replace(
            line,
            share={n: line.size[n] * abs(line.size[n]) / total[n] ** 2 for n in names},
            size={n: line.size[n] for n in names},
            without=None if line.without is None else grown(line.without),
            halved=None if line.halved is None else grown(line.halved),
        )
        for line in budget.lines
    ]
    lines += [_added(line, total) for line in added]
    unmodelled = [
        msgspec.structs.replace(
            line,
            size={n: line.size[n] for n in names},
            with_it=grown(line.with_it),
            far=grown(line.far) if line.far else {},
        )
        for line in budget.unmodelled
    ]
    return BudgetSection(predicted=total, lines=lines, unmodelled=unmodelled)


def _added(line: FileLine, total: Values) -> BudgetLine:
    def share_text(share: float) -> dict[str, float]:
        """The rms errors with a share of the line's mean square."""
        gone = {n: (1.0 - share) * line.rms[n] ** 2 for n in total}
        return {n: max(total[n] ** 2 - gone[n], 0.0) ** 0.5 for n in total}

    return BudgetLine(
        source=line.source,
        kind=line.kind,
        share={n: line.rms[n] ** 2 / total[n] ** 2 for n in total},
        size=dict(line.rms),
        without=share_text(0.0),
        halved=share_text(0.25) if line.kind == "rounding" else None,
    )


def fine_units(content: Compensation, *, driven: bool) -> dict[str, str]:
    """{component: fine unit} of those that the joints drive, or do not."""
    components = content.machine.components
    return {c.name: units.FINE[c.unit] for c in components if c.compensatable == driven}


def _rounding(
    controller: ControllerFormat,
    content: Compensation,
    prediction: PredictionSection,
    shown: Mapping[str, str],
) -> FileLine:
    """Printed digits and the controller's model, at the commands of the workspace."""
    command = content.command
    home = content.machine.home_command[None]
    poses = np.vstack([command, home])
    whole = dataclasses.replace(content, command=poses, grid=None)
    texts = controller.write(whole)
    offsets = None
    if controller.offsets is not None and len(content.further):
        offsets = controller.offsets(texts, whole)
    errors = joint_errors(
        content.kinematics,
        command,
        controller.driven_joints(texts, whole),
        content.identified.values,
        prediction.reference,  # type: ignore[arg-type]
        content.further,
        offsets,
    )
    source = f"printed digits and the controller's model ({controller.name})"
    return FileLine(source, "rounding", _rms(content, errors, shown))


def _interpolation(
    content: Compensation, prediction: PredictionSection, shown: Mapping[str, str]
) -> list[FileLine]:
    """What corrections lose between the table's commands; none where they are no grid."""
    if content.grid is None:
        return []
    try:
        errors = interpolation_errors(
            content.kinematics,
            content.grid,
            content.identified.values,
            prediction.reference,  # type: ignore[arg-type]
            np.random.default_rng(0),
            content.further,
        )
    except AssemblyError:
        return []
    return [FileLine(INTERPOLATION, "interpolation", _rms(content, errors, shown))]


def _effect_lines(content: Compensation, shown: Mapping[str, str]) -> list[FileLine]:
    """What effects' corrections lose between commands, in the worst states, added up."""
    stated = [table.interpolation for table in content.tables if table.interpolation]
    if not stated:
        return []
    rms = {n: sum(costs.get(n, 0.0) for costs in stated) for n in shown}
    return [FileLine(OF_EFFECTS, "interpolation", rms)]


def _left_out(
    prediction: PredictionSection, alone: Values, shown: Mapping[str, str]
) -> FileLine:
    """The effects, from the accuracy with the parameters alone."""
    rms = {}
    for name in shown:
        with_them = prediction.components[name].after.rms
        rms[name] = max(alone[name] ** 2 - with_them**2, 0.0) ** 0.5
    return FileLine(LEFT_OUT, "left out", rms)


def _rms(
    content: Compensation, errors: Array, shown: Mapping[str, str]
) -> dict[str, float]:
    """Rms errors in the units of some components, from errors (n, k), SI."""
    size = np.sqrt(np.mean(errors**2, axis=0))
    names = [c.name for c in content.machine.components]
    return {
        name: units.number(float(size[names.index(name)]), unit)
        for name, unit in shown.items()
    }
