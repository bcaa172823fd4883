"""Takes identified parameters out of a result."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from oed.base.arrays import Array
from oed.model.machine import Machine
from oed.result import CorrectedSection, EstimateSection, StudyResult
from pkm_studies.base.errors import InputError
from pkm_studies.catalogue.controller_format import Identified
from pkm_studies.resolve.earlier_result import controller_values, known_parameters

#: parameters that are drawn from the posterior for simulations
DRAWS = 100
#: what the parameters are where a study allows effects
ABSORBED = (
    "the parameters are the machine's, shifted so that they take up what is known of its"
    " effects over the workspace"
)


def identified_parameters(
    result: StudyResult, machine: Machine, *, tables: bool
) -> Identified | None:
    """The parameters that everything downstream takes; None without an identification.

    `tables` says whether the file holds tables of effects.
    """
    corrected = result.corrected
    if result.final_estimate is None:
        return None
    values, sd = controller_values(result, machine)
    origin = "estimate" if corrected is None else "corrected"
    conditions: tuple[str, ...] = ()
    if corrected is not None:
        conditions = _of_effects(corrected, tables)
    elif result.estimate is not None and result.estimate.controller:
        conditions = (ABSORBED,)
    return Identified(values, sd, origin, conditions)


def drawn_parameters(
    result: StudyResult, machine: Machine, parameters: Identified, folder: Path
) -> Array:
    """Parameters (DRAWS, np), SI, drawn from the posterior about the given ones.

    With its covariance, correlations included; parameters that are held stay.
    """
    section = result.final_estimate
    estimated = set() if section is None else set(section.parameters)
    rows = zip(machine.parameters, parameters.sd, strict=True)
    free = [p.name for p, sd in rows if p.name in estimated and sd > 0.0]
    values = np.tile(parameters.values, (DRAWS, 1))
    if not free:
        return values
    _, covariance, _ = known_parameters(result, machine.name, free, folder)
    rng = np.random.default_rng(0)
    changes = rng.multivariate_normal(np.zeros(len(free)), covariance, DRAWS)
    values[:, [machine.index(name) for name in free]] += changes
    return values


def adjusted_result(result: StudyResult) -> StudyResult:
    """The result with the parameters that the machine has after its adjustments.

    Raises InputError where none were chosen.
    """
    section = result.final_estimate
    if section is None or result.adjustment is None:
        raise InputError(
            "no adjustments were chosen for this result",
            "choose them first: `oed adjust DIR`",
            value="--adjusted",
        )
    parameters = dict(section.parameters)
    for line in result.adjustment.lines:
        p = parameters[line.parameter]
        value, sd = p.value + line.amount, float(np.hypot(p.sd, line.sd))
        parameters[line.parameter] = msgspec.structs.replace(p, value=value, sd=sd)
    part = "estimate" if result.corrected is None else "corrected"
    changed = msgspec.structs.replace(section, parameters=parameters)
    if isinstance(changed, EstimateSection) and changed.controller:
        controller = dict(changed.controller)
        for line in result.adjustment.lines:
            controller[line.parameter] += line.amount
        changed = msgspec.structs.replace(changed, controller=controller)
    return msgspec.structs.replace(result, **{part: changed})


def _of_effects(corrected: CorrectedSection, tables: bool) -> tuple[str, ...]:
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
