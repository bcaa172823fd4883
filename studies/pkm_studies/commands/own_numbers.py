"""A user's own readings of a machine that he names: to parameters, and a plain answer.

The identified numbers differ from those that the machine has by d. With the covariance S of
the estimate and the prior's L, right numbers have d with the covariance S - S L^-1 S: what the
noise does. So the answer is

    no           where errors by such d are as large as those of the machine in 5 % at most,
    yes          otherwise, if they are at most sqrt(2) times those that are left,
    cannot tell  otherwise, with a bad fit, or where more than half is left of what was
                 possible before any reading.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, cast

import numpy as np

from oed import trust, units
from oed.accuracy import ErrorMaps, Reference
from oed.base import Array
from oed.linear_algebra import covariance_root
from oed.result import PredictionSection, StudyResult
from oed.text import join_words
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.earlier_result import controller_values, known_parameters
from pkm_studies.importers import import_files
from pkm_studies.quantities import display_unit
from pkm_studies.resolve import resolve
from pkm_studies.results import error_quantities
from pkm_studies.study import Study, decode_table, tables_of
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent, Origin

#: probability of so large errors of right numbers below which numbers are not good
MIN_P_VALUE: Final = 0.05
#: errors over those of identified numbers that right numbers have at most on average
RIGHT: Final = math.sqrt(2.0)
#: share of the errors before any reading that readings must leave less than
MAX_SHARE: Final = 0.5
#: estimates of right numbers that are drawn: 5 % of them within a tenth
N_DRAWS: Final = 2000
REMEDY: Final = "write NAME_UNIT=NUMBER, such as radius_mm=125, or a list [1, 2]"
ROUNDING: Final = 1e-12  #: what counts as none, in any unit: rounding


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


def calibration_answer(study: Study, result: StudyResult, folder: Path) -> str:
    """A sentence on whether the numbers of the study's machine are good."""
    section = result.judged_prediction
    doubts = trust.objections(result)
    if section is None or doubts:
        reason = doubts[0] if doubts else "no accuracy could be predicted"
        return _answer("cannot tell", f"{reason}.")
    driven = {n: c for n, c in section.components.items() if c.compensatable}
    units_of = {name: section.unit[name] for name in driven}
    before = np.array([c.before.rms for c in driven.values()])
    after = np.array([c.after.rms for c in driven.values()])
    prior, by_noise = _possible_errors(study, result, section, folder)
    unseen = [n for k, n in enumerate(driven) if after[k] > MAX_SHARE * prior[k]]
    if unseen:
        words = join_words(unseen)
        return _answer("cannot tell", f"these readings hardly see errors of {words}.")
    now = error_quantities(dict(zip(driven, before, strict=True)), units_of)
    then = error_quantities(dict(zip(driven, after, strict=True)), units_of)
    reason = (
        f"with the numbers that the machine has now it errs by {now} rms, with the"
        f" identified ones by {then}."
    )
    changed = np.sqrt(np.maximum(before**2 - after**2, 0.0))
    scale = np.maximum(after, ROUNDING)
    is_as_large = (by_noise / scale).max(axis=1) >= (changed / scale).max()
    if np.mean(is_as_large) <= MIN_P_VALUE:
        return _answer("no", reason)
    is_right = (before <= RIGHT * after).all()
    return _answer("yes" if is_right else "cannot tell", reason)


def parameter_sentence(study: Study, result: StudyResult) -> str:
    """The machine's parameters as a controller gets them, beside those that it has."""
    machine = resolve(study).machine
    if result.final_estimate is None:
        return "No parameters."
    values, sd = controller_values(result, machine, with_effects=False)
    parts = []
    for k, p in enumerate(machine.parameters):
        if abs(values[k] - p.nominal) < ROUNDING:
            continue
        unit = display_unit(p.unit)
        number, spread, now = units.from_si([values[k], sd[k], p.nominal], unit)
        parts.append(f"{p.name} {number:.6g} +- {spread:.2g} {unit} (now {now:.6g})")
    return f"Parameters: {'; '.join(parts)}."


def _answer(judgement: str, reason: str) -> str:
    return f"Is the calibration good? {judgement.capitalize()}: {reason}"


def _possible_errors(
    study: Study, result: StudyResult, section: PredictionSection, folder: Path
) -> tuple[Array, Array]:
    """Rms (k,) driven, before readings; (DRAWS, k) of right numbers; fine units."""
    resolved = resolve(study)
    assert resolved.prediction is not None  # the section comes of it
    measurement, machine = resolved.measurement, resolved.machine
    reference = cast(Reference, section.reference)
    maps = ErrorMaps.of(measurement.kinematics, resolved.prediction.command, reference)
    tolerance = measurement.tolerance[: len(machine.parameters)]
    free = np.flatnonzero(tolerance > 0.0)
    names = [machine.parameters[k].name for k in free]
    driven = [k for k, c in enumerate(machine.components) if c.compensatable]
    factors = [units.factor(section.unit[machine.components[k].name]) for k in driven]
    raw = maps.raw[:, driven][:, :, free] / np.array(factors)[:, None]
    prior = np.sqrt(np.mean(np.sum((raw * tolerance[free]) ** 2, axis=2), axis=0))
    _, covariance, _ = known_parameters(result, machine.name, names, folder)
    by_noise = covariance - (covariance / tolerance[free] ** 2) @ covariance
    root = covariance_root(by_noise)
    drawn = np.random.default_rng(0).standard_normal((N_DRAWS, len(root))) @ root.T
    errors = np.einsum("nkf,df->dnk", raw, drawn)
    return prior, np.sqrt(np.mean(errors**2, axis=1))
