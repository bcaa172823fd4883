"""What to adjust at the machine of a result: its lines, files and sentences."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from oed import csv_text, units
from oed.adjustment import AdjustableMachine, AdjustmentPlan
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from oed.result import AdjustedRecord, AdjustmentLine, AdjustmentSection, StudyResult
from pkm_studies import earlier_result, result_folder
from pkm_studies.acceptance import covariances
from pkm_studies.base import InputError
from pkm_studies.compensation import adjusted_result, result_study
from pkm_studies.quantities import component_values
from pkm_studies.resolve import StudyWorkspace, study_kinematics
from pkm_studies.results import (
    Estimated,
    error_quantities,
    estimated_section,
    load_result,
    refuse_bad_fit,
)
from pkm_studies.study import Study
from pkm_studies.user_code import Consent

CSV, NOMINAL = "adjust.csv", "adjusted.toml"


def adjust_folder(
    folder: Path,
    *,
    wanted: str = "",
    study_file: Path | None = None,
    consent: Consent = Consent.RECORDED,
) -> tuple[AdjustmentSection, tuple[Path, ...]]:
    """Choose adjustments for the machine of a result; the section and written files.

    wanted      `z_um=30,theta_arcsec=20`: rms errors by which the components count, and
                the only ones that do; all by their lengths where it is empty
    study_file  study, where it names a machine in a file of its own
    consent     to run that file

    Raises InputError where nothing was identified or nothing is adjustable, and
    BadFitError where the fit promises nothing.
    """
    result = load_result(folder)
    refuse_bad_fit(result)
    study = result_study(result, folder, study_file, consent)
    machine = adjustable_machine(result, study, folder, wanted)
    section = _section(result, machine, wanted)
    result = replace(result, adjustment=section)
    # the machine after the adjustment, as [machine.nominal] of a next study
    adjusted = adjusted_result(result).final_estimate
    lines = [
        f"# {result.machine.name} of study {result.study}, as identified, after the",
        "# adjustments of adjust.csv: replace [machine.nominal] of the next study by this.",
        "",
        "[machine.nominal]",
    ]
    parameter_names = {str(row["name"]) for row in result.machine.parameters}
    parameters = {} if adjusted is None else adjusted.parameters
    for parameter, p in parameters.items():
        if parameter in parameter_names:
            lines.append(f"{parameter}_{p.unit} = {p.value:.9g}  # sd {p.sd:.2g}")
    texts = {CSV: _csv_text(section), NOMINAL: "\n".join(lines) + "\n"}
    result, paths = result_folder.add_files(folder, result, texts)
    if section.lines:
        from pkm_reports import write_adjustment_page

        paths.append(write_adjustment_page(result, folder))
    return section, tuple(paths)


def adjustable_machine(
    result: StudyResult, study: Study, folder: Path, wanted: str
) -> AdjustableMachine:
    """What is known of a result's machine, for `wanted` rms. Raises InputError."""
    section = estimated_section(result, folder)
    kinematics = study_kinematics(study)
    machine = _identifiable(kinematics.machine, section)
    if not any(p.adjust for p in machine.parameters):
        raise InputError(
            f"nothing is stated to move a parameter of {machine.name}",
            'say what does: [[machine.adjust]] with parameters = ["..."] and by = "..."',
            file=str(folder / "result.json"),
            field="machine.adjust",
        )
    identified = machine.nominal.copy()
    for k, parameter in enumerate(machine.parameters):
        if parameter.name in section.parameters:
            estimate = section.parameters[parameter.name]
            identified[k] = units.to_si(estimate.value, estimate.unit)
    workspace = StudyWorkspace(study, kinematics)
    errors = component_values(wanted, "--wanted", machine)
    weights = np.array([1.0 / errors.get(c.name, np.inf) for c in machine.components])
    if not errors:
        weights = np.array(
            [machine.lever if c.unit == "rad" else 1.0 for c in machine.components]
        )
    return AdjustableMachine(
        kinematics=Kinematics(machine),
        command=workspace.regular,
        reference=workspace.reference,
        identified=identified,
        covariance=_covariance(result, machine, identified, section, folder),
        weights=weights,
    )


def _identifiable(machine: Machine, section: Estimated) -> Machine:
    """The machine with the tolerances of the fit; what is fixed there is not adjusted."""
    parameters = []
    for parameter in machine.parameters:
        estimate = section.parameters.get(parameter.name)
        if estimate is None or estimate.prior_sd == 0.0:
            parameters.append(dataclasses.replace(parameter, adjust=None))
            continue
        tolerance = estimate.prior_sd * units.factor(estimate.unit)
        parameters.append(dataclasses.replace(parameter, tolerance=tolerance))
    # the fit has no estimate of what chooses the frame
    return dataclasses.replace(machine.with_parameters(parameters), frame=())


def _covariance(
    result: StudyResult,
    machine: Machine,
    identified: Array,
    section: Estimated,
    folder: Path,
) -> Array:
    """Second moment (np, np), SI, of the posterior's draws, or of the estimate."""
    names = [p.name for p in machine.parameters if p.name in section.parameters]
    draws = None
    if result.posterior is not None and result.corrected is None:
        path = folder / earlier_result.FILE
        draws = earlier_result.read_draws(path, names) if path.is_file() else None
    if draws is None:
        return covariances(machine, section)[0]
    indices = [machine.index(name) for name in names]
    about = draws - identified[indices]
    covariance = np.zeros((len(identified), len(identified)))
    covariance[np.ix_(indices, indices)] = about.T @ about / len(draws)
    return covariance


def _total(adjustable: AdjustableMachine, wanted: str) -> tuple[str, str]:
    """What the total error is and which components do not count; its unit."""
    machine = adjustable.kinematics.machine
    if not wanted:
        return (
            "root of the sum of squares of the components' rms errors in um, angles at a"
            f" lever of {units.number(machine.lever, 'mm'):.4g} mm",
            "um",
        )
    about = f"root of the sum of squares of rms errors over the wanted ones ({wanted})"
    aside = [
        c.name
        for c, w in zip(machine.components, adjustable.weights, strict=True)
        if not w
    ]
    if aside:
        about += f"; {', '.join(aside)} count for nothing"
    return about, "1"


def _section(
    result: StudyResult, adjustable: AdjustableMachine, wanted: str
) -> AdjustmentSection:
    machine = adjustable.kinematics.machine
    plan = adjustable.plan()
    about, total_unit = _total(adjustable, wanted)
    fine = {c.name: units.FINE[c.unit] for c in machine.components}

    def component_values(values: Array) -> dict[str, float]:
        pairs = zip(fine.items(), values, strict=True)
        return {name: units.number(value, unit) for (name, unit), value in pairs}

    return AdjustmentSection(
        reference=adjustable.reference,
        poses=len(adjustable.command),
        unit=fine,
        about=about,
        total_unit=total_unit,
        lines=list(_lines(machine, plan, total_unit)),
        accuracy=[
            AdjustedRecord(
                units.number(a.total, total_unit),
                component_values(a.corrected),
                component_values(a.plain),
            )
            for a in plan.accuracy
        ],
        conditions=[]
        if result.corrected is None
        else list(result.corrected.conditions),
    )


def _lines(
    machine: Machine, plan: AdjustmentPlan, total_unit: str
) -> Iterator[AdjustmentLine]:
    for number, amount, without in zip(
        plan.parameters, plan.amounts, plan.without, strict=True
    ):
        parameter = machine.parameters[number]
        adjust = parameter.adjust
        assert adjust is not None
        unit = units.display(parameter.unit)
        yield AdjustmentLine(
            parameter=parameter.name,
            about=parameter.about,
            by=adjust.by,
            amount=round(units.number(amount, unit), 9),
            unit=unit,
            sd=units.number(adjust.error, unit),
            without=units.number(without, total_unit),
            steps=round(amount / adjust.step) if adjust.step else None,
        )


# -- files and sentences ---------------------------------------------------------------
def _csv_text(section: AdjustmentSection) -> str:
    """Lines with the accuracy after each, the state before the first line at the top."""
    columns = [f"{name}_{unit}" for name, unit in section.unit.items()]
    header: list[object] = [
        "line",
        "parameter",
        "adjustment",
        "amount",
        "unit",
        "steps",
        "fitter_sd",
    ]
    header += ["total_without_it", "total", "total_unit"]
    header += [*columns, *[f"plain_{c}" for c in columns]]
    rows: list[list[object]] = [header]
    for k, record in enumerate(section.accuracy):
        cells: list[object] = [k, *[""] * 7]
        if k:
            a = section.lines[k - 1]
            steps = "" if a.steps is None else a.steps
            amount = f"{a.amount:.9g}"
            cells = [k, a.parameter, a.by, amount, a.unit, steps]
            cells += [f"{a.sd:.3g}", f"{a.without:.6g}"]
        figures = [*record.corrected.values(), *record.plain.values()]
        cells += [f"{record.total:.6g}", section.total_unit]
        rows.append([*cells, *[f"{value:.6g}" for value in figures]])
    return csv_text.of_rows(rows)


def adjustment_sentences(section: AdjustmentSection) -> Iterator[str]:
    """The lines, and the accuracy after each, for a terminal."""
    start = section.accuracy[0]
    if not section.lines:
        yield (
            "No adjustment is worth its work: software corrects what the adjustments"
            " would."
        )
    yield f"Total: {section.about}, over {section.poses} poses, after compensation."
    total = _total_value(section, start.total)
    yield f"As it is: total {total} ({error_quantities(start.corrected, section.unit)})"
    for k, line in enumerate(section.lines, start=1):
        record = section.accuracy[k]
        steps = "" if line.steps is None else f", {line.steps:+d} steps"
        yield (
            f"{k}. {line.by}: {line.amount:+.6g} {line.unit}{steps} in {line.about}"
            f" ({line.parameter})"
        )
        yield (
            f"   then total {_total_value(section, record.total)}"
            f" ({error_quantities(record.corrected, section.unit)}); the whole list without this line:"
            f" total {_total_value(section, line.without)}"
        )
    for condition in section.conditions:
        yield f"The figures rest on: {condition}."


def _total_value(section: AdjustmentSection, value: float) -> str:
    unit = " times what is wanted" if section.total_unit == "1" else " um"
    return f"{value:.4g}{unit}"
