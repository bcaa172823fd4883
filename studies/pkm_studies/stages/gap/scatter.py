"""Sentences of a diagnosis about noise: how it departs from the stated one."""

from __future__ import annotations

from oed.result import DATA_SHEET, GapSection, GoodnessSection
from oed.text import rounded


def sentences(gap: GapSection, factor: float) -> list[str]:
    """That readings scatter beyond the instrument, and how."""
    if gap.scatter_against in ("", DATA_SHEET):
        first = (
            f"The readings scatter {rounded(factor)} times as much as stated, and no effect"
            " explains it: either the instrument is worse than stated, or something acts"
            " in a form that no effect has."
        )
    else:
        first = (
            f"The readings scatter {rounded(factor)} times as much from pose to pose as where"
            f" they were taken again ({gap.scatter_against}), and no effect explains it."
        )
    phrases = [first, f"What scatters: {'; '.join(gap.noise)}."]
    if gap.scatter_shape.startswith(("leg", "run")):
        phrases.append(f"Most of it is in {gap.scatter_shape}.")
    return phrases


def noise_words(checked: GoodnessSection, gap: GapSection | None) -> list[str]:
    """How the noise departs from the stated one, beside the effects of a diagnosis."""
    if not checked.noise_words or gap is None:
        return checked.noise_words
    return [f"Beside what the diagnosis explains, {'; '.join(gap.noise)}."]
