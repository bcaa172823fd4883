"""What a plan said that a healthy machine of its kind reaches, beside the measured error."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from oed.base.text import rounded
from oed.result import PromiseRecord, StudyResult, VerificationSection
from pkm_studies.base import InputError
from pkm_studies.results import load_result


def healthy_accuracy(
    result: StudyResult, plan: Path | None, demands: Mapping[str, PromiseRecord]
) -> dict[str, float]:
    """Rms of each demanded component that a plan with effects predicted, in its unit.

    plan  folder of `oed plan` or `oed run`; by default the result's own plan. Raises
          InputError where a folder's plan allows for no effects, or is of another machine.
    """
    planned = result if plan is None else load_result(plan)
    if planned.machine.name != result.machine.name:
        raise InputError(
            f"that is a plan for the machine {planned.machine.name}",
            f"name a plan for {result.machine.name}",
            field="--plan",
            value=str(plan),
        )
    accuracy = _predicted(planned)
    if plan is not None and not accuracy:
        raise InputError(
            "its plan allows for no effects, and says nothing of a healthy machine",
            'plan with effects = "catalogue" in [plan] or [design]',
            file=str(plan / "result.json"),
            field="--plan",
        )
    keys = {name: f"{name}_{demand.unit}" for name, demand in demands.items()}
    return {name: accuracy[key] for name, key in keys.items() if key in accuracy}


def _predicted(result: StudyResult) -> Mapping[str, float]:
    """Accuracy of the plan, else of the design, on a machine with effects."""
    if result.plan is not None and result.plan.effects is not None:
        return result.plan.accuracy
    if result.design is not None and result.design.effects is not None:
        return result.design.effects.accuracy
    return {}


def healthy_sentences(section: VerificationSection) -> list[str]:
    """The measured errors beside those of a healthy machine; none without a plan."""
    sentences = []
    for name, rms in section.healthy.items():
        verdict = section.components[name]
        times = verdict.rms / rms
        sentences.append(
            f"{name}: the plan predicted {rounded(rms, 3)} {verdict.unit} rms for a healthy machine,"
            f" with all that is known corrected; measured are {rounded(verdict.rms, 3)}"
            f" {verdict.unit}, {rounded(times)} times that."
        )
    return sentences
