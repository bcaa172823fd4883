"""A user's own readings of a machine that he names: to parameters, and a plain answer.

With the numbers that the machine has now its errors have the rms b, with the identified
ones a, and before any reading p. Numbers that are right have b^2 = 2 a^2 at most on
average, as the estimate then errs by no more than its own uncertainty. So they are

    good  if b <= sqrt(2) a,    not good  if b >= 2 a,    else the readings cannot tell,

and readings that leave a > p / 2 tell nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, cast

import numpy as np

from oed import trust, units
from oed.accuracy import Reference, error_maps
from oed.result import PredictionSection, StudyResult
from oed.text import join_words
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.earlier_result import controller_values
from pkm_studies.importers import import_files
from pkm_studies.quantities import display_unit
from pkm_studies.resolve import resolve
from pkm_studies.results import error_quantities
from pkm_studies.study import Study, decode_table, tables_of
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent, Origin

#: errors over those of identified numbers that right numbers have at most, and from which
#: on numbers are not good
RIGHT: Final = math.sqrt(2.0)
WRONG: Final = 2.0
#: share of the errors before any reading that readings must leave less than
SEEN: Final = 0.5
REMEDY: Final = "write NAME_UNIT=NUMBER, such as radius_mm=125, or a list [1, 2]"
#: what counts as none, in any unit: rounding
ZERO: Final = 1e-12


def import_numbers(
    machine: str,
    numbers: Sequence[str],
    readings: Sequence[Path],
    out: Path,
    consent: Consent,
) -> tuple[Path, Sequence[str]]:
    """Write the study of a machine with its readings into `out`; its path, and sentences.

    numbers  such as `radius_mm=125`, of the machine's geometry or of its parameters

    Raises InputError.
    """
    described = _described(machine, numbers, consent) if numbers else machine
    path, session = import_files(
        "numbers", readings, out, machine=described, consent=consent
    )
    return path, session.statements


def _described(machine: str, numbers: Sequence[str], consent: Consent) -> MachineTable:
    """The table [machine] of a model with a user's numbers. Raises InputError."""
    model = catalogue.machine(machine, Origin.command(consent), Location("--machine"))
    table = tables_of("\n".join(numbers), Location("--set"), REMEDY)
    dimensions = () if model.family is None else model.family.dimensions
    sizes = {d.name for d in dimensions}
    geometry = {k: v for k, v in table.items() if k.rpartition("_")[0] in sizes}
    nominal = {k: v for k, v in table.items() if k not in geometry}
    described = {"model": machine, "geometry": geometry, "nominal": nominal}
    return decode_table(MachineTable, described, Location("--set"))


def calibration_answer(study: Study, result: StudyResult) -> str:
    """A sentence on whether the numbers of the study's machine are good."""
    section = result.judged_prediction
    doubts = trust.objections(result)
    if section is None or doubts:
        reason = doubts[0] if doubts else "no accuracy could be predicted"
        return _answer("cannot tell", f"{reason}.")
    driven = {n: c for n, c in section.components.items() if c.compensatable}
    prior = _prior_errors(study, section)
    unseen = [n for n, c in driven.items() if c.after.rms > SEEN * prior[n]]
    if unseen:
        words = join_words(unseen)
        return _answer("cannot tell", f"these readings hardly see errors of {words}.")
    ratio = max(c.before.rms / max(c.after.rms, ZERO) for c in driven.values())
    units_of = {name: section.unit[name] for name in driven}
    now = error_quantities({n: c.before.rms for n, c in driven.items()}, units_of)
    then = error_quantities({n: c.after.rms for n, c in driven.items()}, units_of)
    reason = (
        f"with the numbers that the machine has now it errs by {now} rms, with the"
        f" identified ones by {then}."
    )
    if ratio <= RIGHT:
        return _answer("yes", reason)
    return _answer("no" if ratio >= WRONG else "cannot tell", reason)


def parameter_sentence(study: Study, result: StudyResult) -> str:
    """The machine's parameters as a controller gets them, beside those that it has."""
    machine = resolve(study).machine
    if result.final_estimate is None:
        return "No parameters."
    values, sd = controller_values(result, machine, with_effects=False)
    parts = []
    for k, p in enumerate(machine.parameters):
        if abs(values[k] - p.nominal) < ZERO:
            continue
        unit = display_unit(p.unit)
        number, spread, now = units.from_si([values[k], sd[k], p.nominal], unit)
        parts.append(f"{p.name} {number:.6g} +- {spread:.2g} {unit} (now {now:.6g})")
    return f"Parameters: {'; '.join(parts)}."


def _answer(judgement: str, reason: str) -> str:
    return f"Is the calibration good? {judgement.capitalize()}: {reason}"


def _prior_errors(study: Study, section: PredictionSection) -> dict[str, float]:
    """Rms error of each component before any reading, in its fine unit."""
    resolved = resolve(study)
    assert resolved.prediction is not None  # the section comes of it
    measurement = resolved.measurement
    command = resolved.prediction.command
    reference = cast(Reference, section.reference)
    maps = error_maps(measurement.kinematics, command, reference)
    tolerance = measurement.tolerance[: len(measurement.machine.parameters)]
    rms = np.sqrt(np.mean(np.sum((maps.raw * tolerance) ** 2, axis=2), axis=0))
    return {
        name: units.number(float(value), section.unit[name])
        for name, value in zip(maps.names, rms, strict=True)
    }
