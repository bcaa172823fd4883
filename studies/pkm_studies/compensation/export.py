"""Writes an export, and states what rounding and the controller's model cost."""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from oed import trust, units, verdict
from oed.base import Array
from oed.compensate import GridAxis, compensated_joints
from oed.mechanism import Kinematics, pose_error
from oed.model import Machine
from oed.result import ForecastSection, StudyResult
from oed.safe_files import write_own
from oed.text import format_number
from oed.units import quantity
from oed.verdict import accuracy_verdicts
from pkm_studies import catalogue, files
from pkm_studies.base import InputError, Location
from pkm_studies.catalogue import (
    Compensation,
    ControllerFormat,
    Identified,
    MeasuringPose,
    Texts,
)
from pkm_studies.compensation import identified, table_grid
from pkm_studies.compensation.budget import BUDGET_FILE, complete_budget
from pkm_studies.compensation.identified import adjusted_result, result_study
from pkm_studies.quantities import column
from pkm_studies.resolve import StudyWorkspace, study_kinematics
from pkm_studies.results import BadFitError, load_result
from pkm_studies.study import Study
from pkm_studies.tables import ControllerTable
from pkm_studies.user_code import Consent, Origin


# Makes the content of an export from the result in a folder.
def build_compensation(
    result: StudyResult,
    study: Study,
    folder: Path,
    controller: ControllerFormat,
    largest: int | None = None,
) -> Compensation:
    """The content of an export in a format.

    largest  number of commands of a table; `table_grid.DEFAULT_MAX_COMMANDS` by default

    Raises InputError where nothing was identified, and where `largest` is too small.
    """
    kinematics = study_kinematics(study)
    tables = controller.tables
    machine = kinematics.machine
    parameters = identified.identified_parameters(result, machine, tables=tables)
    measured = result.forecast is not None and bool(result.forecast.corrections)
    if parameters is None and measured:
        nothing = np.zeros(len(machine.parameters))
        parameters = Identified(machine.nominal, nothing, "machine: nominal numbers")
    if parameters is None:
        raise InputError(
            "this result has no identified parameters",
            "run the study with readings: `oed identify STUDY --readings CSV --out DIR`",
            file=str(folder / "result.json"),
        )
    notes = [f"parameters: section {parameters.origin} of result.json"]
    joint_values = study.machine.controller
    if joint_values is not None and (controller.table or controller.joints is not None):
        notes.append(replaces_values(joint_values))
    if identified.is_virtual(result):
        notes.append("the readings are simulated: these values fit no real machine")
    workspace = StudyWorkspace(study, kinematics)
    content = Compensation(
        study=result.study,
        version=result.version,
        machine=machine,
        kinematics=kinematics,
        identified=parameters,
        command=workspace.command,
        poses=_poses(result, machine),
        notes=(*notes, *parameters.conditions),
        tables=tuple(result.corrected.tables) if result.corrected and tables else (),
        controller=study.controller,
        held=joint_values or "",
    )
    if result.forecast is not None and measured:
        content = _add_forecast(content, result.forecast, controller)
    if controller.draws:
        draws = identified.drawn_parameters(result, machine, parameters, folder)
        content = dataclasses.replace(content, draws=draws)
    if not controller.table:
        return content
    return _add_grid(content, result, workspace.axes, largest)


def _add_forecast(
    content: Compensation, section: ForecastSection, controller: ControllerFormat
) -> Compensation:
    """The content with measured errors under the held compensation, if a table takes them."""
    phrase = "errors measured at nodes (oed forecast)"
    if not controller.table or content.held:
        note = f"{phrase} are not in this file: forecast_table.csv comes on top of it"
        return dataclasses.replace(content, notes=(*content.notes, note))
    forecast = table_grid.forecast_corrections(
        section, content.kinematics, content.identified.values
    )
    note = f"{phrase} are part of the table"
    return dataclasses.replace(content, forecast=forecast, notes=(*content.notes, note))


def replaces_values(controller: str) -> str:
    """How a file of a later round relates to what the controller holds."""
    return (
        f"the whole compensation: it replaces what the controller holds ({controller});"
        " do not add the two"
    )


def _add_grid(
    content: Compensation,
    result: StudyResult,
    axes: tuple[GridAxis, ...],
    largest: int | None,
) -> Compensation:
    """The content with the grid of its table, where its workspace is in reach."""
    correction = table_grid.table_correction(content)
    want = table_grid.add_offsets(
        table_grid.TableAccuracy.predicted(content.kinematics, result.final_prediction),
        content.further,
        result.final_prediction,
    )
    most = table_grid.DEFAULT_MAX_COMMANDS if largest is None else largest
    grid = want.grid(axes, correction, most)
    if grid is None:
        return content
    notes = (*content.notes, *table_grid.sentences(grid, want))
    if grid.axes != axes:
        notes += (
            "the table is narrower than the workspace: its corners are out of reach",
        )
    return dataclasses.replace(content, grid=grid, notes=notes)


def _poses(result: StudyResult, machine: Machine) -> tuple[MeasuringPose, ...]:
    if result.design is None:
        return ()
    return tuple(
        MeasuringPose(p.setup, p.run, _command(p.command, machine))
        for p in result.design.poses
    )


def _command(displayed: dict[str, float], machine: Machine) -> Array:
    values = []
    for coordinate in machine.command:
        name = column(coordinate.name, coordinate.unit)
        values.append(float(units.to_si(displayed[name], units.split(name)[1])))
    return np.array(values)


#: the end of a file's name that is no part of the name itself
ENDING = re.compile(r"\.[A-Za-z]\w*")
#: for which machine a file holds after `oed adjust`; the prediction is of the estimate
AFTER_ADJUSTMENT = (
    "for the machine after all adjustments of adjust.csv, where the fitter's own error"
    " comes on top of the predicted rms of the file"
)


@dataclasses.dataclass(frozen=True)
class Export:
    """Written files, and sentences on what they hold."""

    paths: tuple[Path, ...]
    sentences: tuple[str, ...]


def export_folder(
    folder: Path,
    reference: str,
    *,
    out: Path | None = None,
    study_file: Path | None = None,
    force: bool = False,
    commands: int | None = None,
    firmware: str | None = None,
    adjusted: bool = False,
    consent: Consent = Consent.RECORDED,
) -> Export:
    """Write the result of a folder in a format.

    reference   name of a format, or `path/to/file.py:attribute`
    out         file to write; compensation.* in the folder by default
    study_file  study, where it names a machine in a file of its own
    force       whether to write a bad fit
    commands    largest number of commands of a table
    firmware    version of the controller's firmware
    adjusted    whether the adjustments of `oed adjust` were made
    consent     to run Python files that `reference` and `study_file` name

    Raises InputError, and BadFitError where the fit is bad.
    """
    controller = named_format(reference, Origin.command(consent))
    result = load_result(folder)
    study = result_study(result, folder, study_file, consent)
    if firmware is not None:
        study = _add_version(study, controller, firmware)
    notes = _held_notes(result)
    if adjusted:
        result = adjusted_result(result)
        notes = (*notes, AFTER_ADJUSTMENT)
    return export_result(
        result,
        study,
        controller,
        folder,
        out=out,
        force=force,
        commands=commands,
        notes=notes,
    )


def named_format(reference: str, origin: Origin) -> ControllerFormat:
    """The format that `reference` names. Raises InputError."""
    controller: ControllerFormat = catalogue.lookup(
        reference, "formats", ControllerFormat, origin, Location("--to")
    )
    return controller


def _held_notes(result: StudyResult) -> tuple[str, ...]:
    """Sentences on what the model holds and the readings contradict: no file takes it up."""
    section = result.estimate
    if section is None or not section.held:
        return ()
    sentences = section.warnings[: len(section.held)]
    beyond = (
        "the predicted errors do not hold this: the machine may err by as much more"
    )
    return (*sentences, beyond)


def _add_version(study: Study, controller: ControllerFormat, version: str) -> Study:
    if not controller.versions:
        raise InputError(
            f"{controller.name} is the same for all versions",
            "leave it out",
            field="--firmware",
            value=version,
        )
    firmware = study.controller
    if firmware is None or firmware.firmware != controller.name:
        firmware = ControllerTable(firmware=controller.name)
    stated = msgspec.structs.replace(firmware, version=version, m665_b=None)
    return msgspec.structs.replace(study, controller=stated)


def export_result(
    result: StudyResult,
    study: Study,
    controller: ControllerFormat,
    folder: Path,
    *,
    out: Path | None = None,
    force: bool = False,
    commands: int | None = None,
    notes: tuple[str, ...] = (),
) -> Export:
    """As `export_folder`, from a result in memory; `notes` are further comments."""
    objections = trust.objections(result)
    if objections and not force:
        raise BadFitError(
            f"{'; '.join(objections)}: nothing is written; {trust.remedy(result)}, or"
            " give --force"
        )
    content = build_compensation(result, study, folder, controller, commands)
    notes += tuple(f"written by --force: {reason}" for reason in objections)
    content = dataclasses.replace(content, notes=(*content.notes, *notes))
    reason = controller.unfit(content.machine)
    if reason is not None:
        raise InputError(
            f"{controller.name} cannot drive {content.machine.name}: {reason}",
            "take c, csv or json, or a format of your own: path/to/file.py:attribute",
            value=f"--to {controller.name}",
        )
    content = dataclasses.replace(
        content, notes=(*content.notes, *controller.notes(content))
    )
    texts = controller.write(content)
    # a forecast corrects what the model lacks: it is no cost of the file
    modelled = dataclasses.replace(content, forecast=None)
    whole = complete_budget(controller, modelled, result)
    sentences = (
        *content.notes,
        *cost(controller, modelled),
        *verdict_sentences(
            result,
            corrects_effects=controller.tables and bool(content.tables),
            added={} if whole is None else whole.added,
        ),
    )
    if whole is not None:
        document = msgspec.json.format(msgspec.json.encode(whole.section), indent=1)
        texts = {**texts, BUDGET_FILE: document.decode() + "\n"}
        advice = [sentence.rstrip(".") for sentence in whole.section.advice[:1]]
        sentences = (*sentences, whole.sentence, *advice)
    return Export(_write(texts, folder, out), sentences)


def verdict_sentences(
    result: StudyResult, *, corrects_effects: bool, added: Mapping[str, float]
) -> list[str]:
    """The verdict on what the study wants, of the machine with this compensation.

    added  {component: rms error in its unit} of the file's tables and digits
    """
    verdicts = accuracy_verdicts(
        result, geometry_sent=not corrects_effects, added=added
    )
    parts = [
        verdict.sentence(name, v, format_number(v.rms), format_number(v.wanted))
        for name, v in verdicts.items()
    ]
    if not parts:
        return []
    scopes = ", ".join(dict.fromkeys(v.scope for v in verdicts.values()))
    sent = "its effects as well" if corrects_effects else "the geometry alone"
    decide = dict.fromkeys(v.decide.rstrip(".") for v in verdicts.values() if v.decide)
    return [
        f"wanted, where the controller corrects {sent}: {'; '.join(parts)}; {scopes}",
        *(f"to decide what is wanted: {phrase}" for phrase in decide),
    ]


def undriven_components(machine: Machine, remaining: Array) -> tuple[str, ...]:
    """A sentence on undriven components, from errors (n, k), SI; None without any."""
    largest = np.abs(remaining).max(axis=0)
    parts = [
        f"{component.name} {quantity(size, component.unit)}"
        for component, size in zip(machine.components, largest, strict=True)
        if not component.compensatable
    ]
    if not parts:
        return ()
    return (f"no joint drives these components, at most: {', '.join(parts)}",)


def _component_errors(
    kinematics: Kinematics, command: Array, joints: Array, parameters: Array
) -> Array:
    """Exact errors (n, k) of the machine's pose components, SI, as in `pose_error`."""
    twist = pose_error(kinematics, command, joints, parameters)
    return kinematics.error_components(command, twist)


def cost(controller: ControllerFormat, content: Compensation) -> tuple[str, ...]:
    """What the controller's model and the printed digits cost, and what stays.

    Both hold at the commands of the workspace, as if the file had these.
    """
    kinematics, values = content.kinematics, content.identified.values
    command = StudyWorkspace.regular_at(kinematics, content.command)
    if not len(command):
        return ()
    exact = compensated_joints(kinematics, command, values)
    errors = _component_errors(kinematics, command, exact, values)
    remaining = undriven_components(content.machine, errors)
    if controller.joints is None:
        return remaining
    written = dataclasses.replace(content, command=command, grid=None)
    joints = controller.driven_joints(controller.write(written), written)
    errors = _component_errors(kinematics, command, joints, values)
    largest = np.abs(errors).max(axis=0)
    parts = [
        f"{c.name} {quantity(size, c.unit)}"
        for c, size in zip(content.machine.components, largest, strict=True)
        if c.compensatable
    ]
    sentence = (
        f"the controller's model and the printed digits cost at most {', '.join(parts)}"
        f" over {len(command)} poses"
    )
    return (sentence, *remaining)


def _write(texts: Texts, folder: Path, out: Path | None) -> tuple[Path, ...]:
    """Write the texts; a file that a user names is never replaced."""
    if out is None:
        files.make_folder(folder)
        return tuple(
            write_own(folder / f"compensation{suffix}", text.encode())
            for suffix, text in texts.items()
        )
    stem = out.stem if ENDING.fullmatch(out.suffix) else out.name
    others = [out.with_name(f"{stem}{suffix}") for suffix in list(texts)[1:]]
    paths = [out, *others]
    for path in paths:
        if path.exists():
            raise InputError(
                "this file is there already", "name another one", file=str(path)
            )
    files.make_folder(out.parent)
    return files.write_all(dict(zip(paths, texts.values(), strict=True)))
