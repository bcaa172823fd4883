"""States in sentences what planned readings could find, and what chosen runs gain."""

from __future__ import annotations

from oed.result.gap_before import ChosenRuns, DetectabilityTable, GapBeforeSection
from pkm_studies.stages.gap.words import capitalised, join_words, plain_name

#: most effects and pairs in one sentence
MOST = 6


def sentences(section: GapBeforeSection) -> list[str]:
    """The gain of the chosen runs, and what they or the planned readings can find."""
    if section.chosen is None:
        return _findings("The planned readings", section.table)
    return [
        _gain(section.chosen),
        *_findings("The chosen runs", section.chosen.table),
    ]


def _gain(chosen: ChosenRuns) -> str:
    pairs = set()
    for s in chosen.separations:
        pairs.add(" and ".join(sorted((plain_name(s.effect), plain_name(s.rival)))))
    named = "; ".join(sorted(pairs)[:MOST])
    bound = f"no plan exceeds {chosen.bound:.1f}"
    if chosen.proven:
        bound = "no plan is better"
    before = "" if chosen.before is None else f" from {chosen.before:.1f}"
    added = f"{len(chosen.runs) - chosen.retained} of {chosen.candidates}"
    retained = f", added to {chosen.retained} retained runs," if chosen.retained else ""
    return (
        f"{added} candidate runs{retained} raise the least distinguishability of"
        f" {named}{before} to {chosen.separation:.1f} ({bound})."
    )


def _findings(readings: str, table: DetectabilityTable) -> list[str]:
    visible = [e for e in table.effects if e.visible]
    testable = [e for e in table.effects if e.not_testable is None]
    too_weak = [plain_name(e.name) for e in testable if not e.visible]
    missed = f"; too weak for them: {join_words(too_weak)}" if too_weak else ""
    sentences = [
        f"{readings} find {len(visible)} of the {len(table.names)} effects that they"
        " can test, at the expected sizes (90 % chance at 1 % false alarm)"
        f"{missed}."
    ]
    absorbed = dict.fromkeys(effect for effect, _ in table.absorbed)
    for name in list(absorbed)[:MOST]:
        rivals = [
            plain_name(rival) for effect, rival in table.absorbed if effect == name
        ]
        subject = capitalised(plain_name(name))
        sentences.append(
            f"{subject} could also be explained by {join_words(rivals, 'or')}."
        )
    for first, second in table.exact[:MOST]:
        sentences.append(
            f"Some forms of {plain_name(first)} and {plain_name(second)} are identical"
            " in these readings, whatever their size."
        )
    untestable = [
        plain_name(e.name) for e in table.effects if e.not_testable is not None
    ]
    if untestable:
        sentences.append(f"They cannot test {join_words(untestable)}.")
    return sentences
