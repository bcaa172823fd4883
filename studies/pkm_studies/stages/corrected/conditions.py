"""States in sentences what the accuracy of a corrected machine rests on."""

from __future__ import annotations

import numpy as np

from oed.compensate.effects import CorrectedEstimate
from oed.compensate.effects.forms import ChosenForm
from oed.gap.data.diagnosis import UNKNOWN
from oed.result import GapSection

#: what a controller must know, by the covariate that an effect needs
KNOWN = {
    "direction": "the direction of travel of each joint is known",
    "feed": "the feed is known",
    "payload": "the payload is known",
    "tension": "the tension of each cable is known",
}

#: effects that change with the payload, where readings have several
LOADED = ("gravity", "frame_bending")


def conditions(corrected: CorrectedEstimate, gap: GapSection | None) -> list[str]:
    """One sentence for each condition."""
    moving = [f.effect.name for f in corrected.forms if _moves_machine(corrected, f)]
    sentences = []
    if moving:
        names = ", ".join(moving)
        sentences.append(f"the controller corrects {names} as well as the parameters")
    for form in corrected.forms:
        sentences += _of_effect(corrected, form)
    if gap is not None:
        sentences += _of_diagnosis(corrected, gap)
    return list(dict.fromkeys(sentences))


def _of_effect(corrected: CorrectedEstimate, form: ChosenForm) -> list[str]:
    """Conditions of one effect."""
    name = form.effect.name
    if not _moves_machine(corrected, form):
        return [
            f"{name}: it belongs to the measurement; the machine needs no correction"
        ]
    sentences = []
    for need in form.effect.needs:
        covariate = need.partition(":")[0].strip()
        if covariate in KNOWN:
            sentences.append(f"{name}: {KNOWN[covariate]}")
        elif "time" in need or "temp" in need:
            sentences.append(_of_warmth(name, form))
    if not sentences and name in LOADED:
        sentences.append(f"{name}: the payload is known, or that of these readings")
    return sentences


def _of_warmth(name: str, form: ChosenForm) -> str:
    if any("per kelvin" in n for n in form.signature.names):
        return f"{name}: the temperatures are read as in these readings"
    return (
        f"{name}: no temperature was recorded, so that the correction holds for the"
        " warm-up of this session alone"
    )


def _moves_machine(corrected: CorrectedEstimate, form: ChosenForm) -> bool:
    """Whether the effect changes joints or parameters of the machine."""
    columns = [
        column
        for state in corrected.states
        for column in form.effect.columns(state, **form.constants)
    ]
    known = {p.name for p in corrected.measurement.machine.parameters}
    joints = any(np.any(v) for c in columns for v in c.joints.values())
    return joints or any(n in known for c in columns for n in c.parameters)


def _of_diagnosis(corrected: CorrectedEstimate, gap: GapSection) -> list[str]:
    """What the diagnosis could not decide."""
    sentences = []
    used = {form.effect.name for form in corrected.forms}
    for group in gap.confusable:
        rivals = [n for n in group if n not in used]
        if rivals and used & set(group):
            taken = next(n for n in group if n in used)
            sentences.append(
                f"{taken} is the cause: these readings cannot distinguish it from"
                f" {', '.join(rivals)}"
            )
    if gap.answers and UNKNOWN in gap.answers[0].effects:
        sentences.append(
            "a part of the gap of unknown form is not in the model: it stays, and the"
            " predicted accuracy does not contain it"
        )
    return sentences
