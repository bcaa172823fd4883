"""Takes identified parameters out of a result."""

from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from oed.base import Array
from oed.model import Machine
from oed.result import (
    AdjustmentSection,
    CompensationName,
    CorrectedSection,
    EstimateSection,
    MixtureSection,
    PredictionSection,
    StudyResult,
)
from pkm_studies import user_code
from pkm_studies.base import InputError, Location
from pkm_studies.catalogue import Identified
from pkm_studies.earlier_result import (
    controller_values,
    known_parameters,
    machine_difference,
)
from pkm_studies.resolve import study_machine
from pkm_studies.study import SUFFIX, Study
from pkm_studies.user_code import Consent


# The study of a stored result: its own text, without code, or the file that is given.
def result_study(
    result: StudyResult,
    folder: Path,
    study_file: Path | None,
    consent: Consent = Consent.RECORDED,
) -> Study:
    """The study in a file, or that which the result in a folder holds.

    consent  to run Python files that the file names; the result's own study never runs
             one

    Raises InputError where the result does not hold its study, where its machine is a
    Python file, and where the file is the study of another machine.
    """
    location = Location(str(folder / "result.json"))
    if study_file is not None:
        study = Study.load(study_file, consent)
        difference = machine_difference(result.machine, study_machine(study))
        if difference is None:
            return study
        raise location.error(
            f"the machine of {study_file} is not that of this result: {difference}",
            "give the study that the result was made with",
        )
    if not result.study_text:
        raise location.error("this result holds no study", "give it: --study STUDY")
    path = folder / f"{result.study}{SUFFIX}"
    study = Study.parse(result.study_text, path, Consent.NEVER)
    model = study.machine.model
    if user_code.is_file(model):
        raise location.error(
            f"the machine is the Python file {user_code.file_name(model)}, and a result"
            " runs no code",
            "give the study: --study STUDY",
        )
    return study


Section = TypeVar("Section", bound=EstimateSection | CorrectedSection | MixtureSection)
POSTERIOR_DRAWS = 100  #: parameters that are drawn from the posterior for simulations
#: what the parameters are where effects may act and are not corrected
SENT = {
    CompensationName.MIXTURE: "the parameters are the mean of what is known, over all hypotheses where there"
    " is a diagnosis, shifted so that they take up what is known of effects over the"
    " workspace",
    CompensationName.BEST: "the parameters are those of the likeliest answer, which are expected to leave"
    " the least error",
    CompensationName.PLAIN: "the parameters are those of a fit without effects, which are expected to leave"
    " the least error",
}


def identified_parameters(
    result: StudyResult, machine: Machine, *, tables: bool
) -> Identified | None:
    """The parameters that a file of `tables`, or none, takes; None without any."""
    corrected = result.corrected
    if result.final_estimate is None:
        return None
    with_effects = tables and corrected is not None and bool(corrected.tables)
    values, sd = controller_values(result, machine, with_effects=with_effects)
    origin = "estimate" if corrected is None else "corrected"
    conditions: tuple[str, ...] = ()
    mixture = result.controller_mixture
    if mixture is not None and not with_effects:
        origin = "gap.mixture"
        conditions = _mixture_parameters(mixture, corrected, tables)
    elif corrected is not None:
        conditions = (*_effect_parameters(corrected, tables), *_if_not_best(mixture))
        if corrected.controller and not with_effects:
            conditions = (SENT[CompensationName.PLAIN], *conditions)
    elif result.estimate is not None and result.estimate.controller:
        conditions = (SENT.get(result.estimate.sent, SENT[CompensationName.BEST]),)
    return Identified(values, sd, origin, conditions)


def drawn_parameters(
    result: StudyResult, machine: Machine, parameters: Identified, folder: Path
) -> Array:
    """Parameters (DRAWS, np), SI, of the posterior's covariance about the given ones."""
    section = result.final_estimate
    estimated = set() if section is None else set(section.parameters)
    rows = zip(machine.parameters, parameters.sd, strict=True)
    free = [p.name for p, sd in rows if p.name in estimated and sd > 0.0]
    values = np.tile(parameters.values, (POSTERIOR_DRAWS, 1))
    if not free:
        return values
    _, covariance, _ = known_parameters(result, machine.name, free, folder)
    rng = np.random.default_rng(0)
    changes = rng.multivariate_normal(np.zeros(len(free)), covariance, POSTERIOR_DRAWS)
    values[:, [machine.index(name) for name in free]] += changes
    return values


def adjusted_result(result: StudyResult) -> StudyResult:
    """The result after its adjustments. Raises InputError where none were chosen."""
    section, adjustment = result.final_estimate, result.adjustment
    if section is None or adjustment is None:
        raise InputError(
            "no adjustments were chosen for this result",
            "choose them first: `oed adjust DIR`",
            value="--adjusted",
        )
    parameters = dict(section.parameters)
    for line in adjustment.lines:
        p = parameters[line.parameter]
        value = p.value + line.amount
        sd = float(np.hypot(p.sd, line.sd))
        parameters[line.parameter] = msgspec.structs.replace(p, value=value, sd=sd)
    result = _adjusted_mixture(result, adjustment)
    part = "estimate" if result.corrected is None else "corrected"
    section = msgspec.structs.replace(section, parameters=parameters)
    changed = _adjusted_controller(section, adjustment)
    return msgspec.structs.replace(result, **{part: changed})


def _adjusted_mixture(
    result: StudyResult, adjustment: AdjustmentSection
) -> StudyResult:
    """The result whose controller parameters over all hypotheses have the adjustments."""
    mixture = result.controller_mixture
    if mixture is None or result.gap is None:
        return result
    changed = _adjusted_controller(mixture, adjustment)
    gap = msgspec.structs.replace(result.gap, mixture=changed)
    return msgspec.structs.replace(result, gap=gap)


def _adjusted_controller(section: Section, adjustment: AdjustmentSection) -> Section:
    """The section whose parameters for the controller, if any, have the adjustments."""
    controller = dict(section.controller)
    for line in adjustment.lines:
        if line.parameter in controller:
            controller[line.parameter] += line.amount
    return msgspec.structs.replace(section, controller=controller)


def _effect_parameters(corrected: CorrectedSection, tables: bool) -> tuple[str, ...]:
    """Sentences on the effects: which the file holds, and what the others cost."""
    tabled = dict.fromkeys(t.effect for t in corrected.tables) if tables else {}
    sentences = []
    if tabled:
        states = ", ".join(dict.fromkeys(t.state for t in corrected.tables))
        sentences.append(
            f"joint corrections by {states}: {', '.join(tabled)}; the controller adds"
            " those of the states as they are"
        )
    left_out = [name for name in corrected.constants if name not in tabled]
    if left_out:
        sentences.append(f"not in this file: {_listed(corrected, left_out, tables)}")
    if corrected.prediction is None:
        return tuple(sentences)
    parts = [
        f"{name} {alone.rms:.3g} {alone.unit}"
        f" ({corrected.prediction.components[name].after.rms:.3g} with them)"
        for name, alone in corrected.parameters_only.items()
    ]
    return (*sentences, f"predicted rms without the effects: {', '.join(parts)}")


def _mixture_parameters(
    mixture: MixtureSection, corrected: CorrectedSection | None, tables: bool
) -> tuple[str, ...]:
    """What the parameters over all hypotheses are, what stays, and what is reached."""
    sentences = [SENT.get(mixture.sent, SENT[CompensationName.BEST])]
    if corrected is not None:
        left_out = list(corrected.constants)
        sentences.append(f"not in this file: {_listed(corrected, left_out, tables)}")
    if mixture.prediction is not None:
        rms = _rms_of(mixture.prediction)
        sentences.append(f"predicted rms over all hypotheses: {rms}")
    return tuple(sentences)


def _if_not_best(mixture: MixtureSection | None) -> tuple[str, ...]:
    """What all answers expect of the best answer with its effects corrected."""
    if mixture is None or mixture.with_effects is None:
        return ()
    rms = _rms_of(mixture.with_effects)
    return (
        "these figures take the diagnosis' best hypothesis as true; over all of its hypotheses"
        f" the predicted rms with this compensation is {rms}",
    )


def _rms_of(prediction: PredictionSection) -> str:
    """Rms errors after compensation, each with its unit."""
    parts = [
        f"{name} {component.after.rms:.3g} {component.after.unit}"
        for name, component in prediction.components.items()
    ]
    return ", ".join(parts)


def _listed(corrected: CorrectedSection, names: list[str], tables: bool) -> str:
    """Effects that a file does not hold, with the reason where tables are possible."""
    if not tables:
        listed = ", ".join(names)
        return f"{listed}; a controller corrects them by their states (csv, json)"
    reasons = corrected.not_tabled
    return "; ".join(f"{n} ({reasons[n]})" if n in reasons else n for n in names)


def is_virtual(result: StudyResult) -> bool:
    """Whether the readings are those of a virtual machine."""
    estimate = result.estimate
    if estimate is None:
        return False
    return any(p.truth is not None for p in estimate.parameters.values())
