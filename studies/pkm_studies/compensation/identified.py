"""Takes identified parameters out of a result."""

from __future__ import annotations

from oed.model.machine import Machine
from oed.result import CorrectedSection, StudyResult
from pkm_studies.catalogue.controller_format import Identified
from pkm_studies.resolve.earlier_result import identified_values


def identified_parameters(
    result: StudyResult, machine: Machine, *, tables: bool
) -> Identified | None:
    """The parameters that everything downstream takes; None without an identification.

    `tables` says whether the file holds tables of effects.
    """
    corrected = result.corrected
    if result.final_estimate is None:
        return None
    values, sd = identified_values(result, machine)
    origin = "estimate" if corrected is None else "corrected"
    conditions = () if corrected is None else _of_effects(corrected, tables)
    return Identified(values, sd, origin, conditions)


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
