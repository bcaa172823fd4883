"""What else to record, in a sentence."""

from __future__ import annotations

from oed.result import DesignSection, PlanSection
from pkm_studies.stages.plan.phrases import percent

#: share of the error from which a choice is named
LEAST_GAIN = 0.01
#: choices that are named, at most
NAMED = 3


def recording_sentences(*sections: PlanSection | DesignSection | None) -> list[str]:
    """What else to record beside the plans, the best first; none without effects."""
    sentences = []
    for section in sections:
        effects = None if section is None else section.effects
        recording = None if effects is None else effects.recording
        choices = [] if recording is None else recording.choices
        parts = []
        for choice in [c for c in choices if c.gain >= LEAST_GAIN][:NAMED]:
            worth = "as no number of further readings does without"
            if choice.readings is not None:
                worth = f"worth {choice.readings} further readings"
            share = percent(choice.gain)
            parts.append(f"{choice.words} (errors {share} smaller, {worth})")
        if parts:
            sentences.append(f"What else to record: {'; '.join(parts)}.")
    return sentences
