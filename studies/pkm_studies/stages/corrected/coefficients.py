"""Coefficients of the joint estimate, for the diagnosis and its sentences."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from oed.corrected import CorrectedEstimate
from oed.result import CoefficientRecord, GapSection
from pkm_studies.stages.gap import implausible, sentences


def coefficient_records(corrected: CorrectedEstimate) -> Iterator[CoefficientRecord]:
    """Each coefficient, SI."""
    estimate, k = corrected.estimate, 0
    start = corrected.parameters
    for form in corrected.forms:
        signature = form.signature
        parts = zip(signature.names, signature.labels, signature.shape, strict=True)
        for name, label, shape in parts:
            scale = float(corrected.scales[k])
            yield CoefficientRecord(
                effect=form.effect.name,
                name=name,
                label=label,
                value=float(estimate.theta[start + k]) * scale,
                sd=float(estimate.sd[start + k]) * scale,
                unit=form.effect.unit(name),
                prior_sd=scale,
                shape=bool(shape),
            )
            k += 1


def add_joint_coefficients(gap: GapSection, corrected: CorrectedEstimate) -> GapSection:
    """The diagnosis with the coefficients that are estimated with the parameters.

    It names effects by linear models of single forms; what they amount to comes from the
    nonlinear fit of all of them, which the accuracy rests on as well.
    """
    joint = list(coefficient_records(corrected))
    effects = {c.effect for c in joint}
    others = [c for c in gap.coefficients if c.effect not in effects]
    named = [c for c in joint if c.effect in gap.selected]
    constants = {
        form.effect.name: dict(form.constants)
        for form in corrected.forms
        if form.effect.name in gap.selected
    }
    return sentences.add_sentences(
        msgspec.structs.replace(
            gap,
            coefficients=[*named, *others],
            constants={**gap.constants, **constants},
        )
    )


def implausible_sizes(corrected: CorrectedEstimate) -> list[str]:
    """One sentence for each effect with a coefficient far beyond its expected size."""
    checks = {form.effect.name: form.effect.check for form in corrected.forms}
    return implausible.sentences(coefficient_records(corrected), checks)
