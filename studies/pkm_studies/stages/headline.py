"""Writes the headline: the result in up to five sentences, the most useful first."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from oed import safe_files, verdict
from oed.design import CRITERIA
from oed.result import (
    BudgetSection,
    CorrectedSection,
    DesignSection,
    EstimateSection,
    GoodnessSection,
    IdentifiabilitySection,
    MachineInfo,
    PlanScore,
    PlanSection,
    PosteriorSection,
    PredictionSection,
    StudyResult,
)
from oed.text import format_number, guaranteed_percent, join_words
from oed.verdict import accuracy_verdicts
from pkm_studies import console, result_folder
from pkm_studies.console import DONE, FAILED
from pkm_studies.results import error_quantities
from pkm_studies.stages import forecast
from pkm_studies.stages.gap.sentences import noise_words, plain_name
from pkm_studies.stages.plan.plan import percent, plan_sentences

if TYPE_CHECKING:
    from oed.result import Claim, StudyResult
    from pkm_reports.blocks import Table


# A design in sentences: what its readings reach, and on a machine with effects.
def gain_sentences(section: DesignSection) -> list[str]:
    """How much more accurate the machine becomes than with the first reference plan."""
    if len(section.plans) < 2 or not section.plans[0].gain:
        return []
    gains = section.plans[0].gain.values()
    reference = section.plans[1]
    readings = f"{section.n} readings in {', '.join(section.setups)}"
    return [
        f"With the {readings}, the pose is {min(gains):.2g} to {max(gains):.2g} times as"
        f" accurate as with {reference.name}."
    ]


def design_sentences(section: DesignSection) -> list[str]:
    """What the readings reach by the criterion, beside the reference plans.

    Reference plans are judged without effects, as the chosen one is beside them.
    """
    criterion = section.criterion
    reached = _value(criterion, section.value)
    if section.effects is not None:
        alone = _value(criterion, section.plans[0].value)
        reached += f" with effects{_proof(section)}, and without any {alone}"
    else:
        reached += _proof(section)
    others = [_other_plan(plan, criterion) for plan in section.plans[1:]]
    against = f", against {'; '.join(others)}" if others else ""
    return [
        f"The {criterion}-optimal {section.n} readings reach {reached}{against};"
        f" the condition number is {format_number(section.kappa)}"
        f" ({section.scaling} scaling)."
    ]


def _value(criterion: str, value: float) -> str:
    label = _label(criterion)
    if label:
        return f"{label} {value:.2f}"
    return f"{criterion} = {format_number(value)}"


def _label(criterion: str) -> str:
    """What the criterion's number is called; empty where by the criterion's name."""
    entry = CRITERIA.entry(criterion)
    return "" if entry is None else entry.label


def _proof(section: DesignSection) -> str:
    """How far from the best possible the choice may be."""
    if section.proven:
        return " (proven optimal)"
    if section.efficiency is None:
        return ""
    share = guaranteed_percent(section.efficiency)
    return f" (certified to {share:.1f} % of the best possible)"


def effects_sentences(section: DesignSection) -> list[str]:
    """What the plan reaches on a machine with effects, beside the plan without them."""
    allowed = section.effects
    if allowed is None:
        return []
    parts = []
    for key, value in allowed.accuracy.items():
        name, _, unit = key.rpartition("_")
        other = allowed.accuracy_without[key]
        parts.append(f"{name} {value:.3g} ({other:.3g}) {unit}")
    return [
        f"The plan allows for {allowed.groups} groups of effects. With these at the sizes expected"
        " of them it leaves rms errors, in brackets those of the plan for a machine without"
        f" effects: {', '.join(parts)}."
    ]


def _other_plan(plan: PlanScore, criterion: str) -> str:
    by_log_det = bool(_label(criterion))
    value = f"{plan.logdet:.2f}" if by_log_det else format_number(plan.value)
    share = f"{100 * plan.efficiency:.0f} % {criterion}-efficiency"
    return f"{value} for {plan.name} ({share})"


MAX_SENTENCES = 5
REFERENCES = {
    "home": "zeroed at home",
    "absolute": "in the base frame",
    "best_fit": "after best alignment",
}
MIN_GAIN = 0.01  #: share of the error from which a choice is named
MAX_NAMED_CHOICES = 3  #: choices that are named, at most


def sentences(
    result: StudyResult, recorded: bool = False, machine: MachineInfo | None = None
) -> list[str]:
    """Sentences about the sections that are there.

    Findings about the readings come first, then a diagnosis, then held-out readings.
    Readings that are `recorded` have no design. `machine`: what earlier sessions give.
    """
    chosen = None if recorded else result.design
    findings = [] if result.gap is None else result.gap.findings
    checked = result.goodness
    alarms = [] if checked is None else checked.findings
    rounds = [] if machine is None else earlier_sentences(machine)
    held_out = [f"{section.words}." for section in result.held_out]
    identified = result.identifiability
    return [
        *alarms,
        *findings,
        *noise_sentences(result),
        *rounds,
        *held_out,
        *itertools.islice(_ranked(result, chosen), MAX_SENTENCES),
        *([] if identified is None else CRITERIA.sentences(identified.indices)),
        *recording_sentences(result.plan, chosen),
    ]


def _ranked(result: StudyResult, design: DesignSection | None) -> Iterator[str]:
    """Sentences about the sections that are there, the most useful first."""
    prediction, before = result.judged_prediction, result.gap_before
    yield from plan_sentences(result.plan)
    if before is not None and before.chosen is not None:
        yield from before.words[:1]
    if result.corrected is not None:
        yield from _corrected(result.corrected)
    elif prediction is not None:
        yield _accuracy(prediction)
    yield from _wanted(result)
    yield from _unmodelled(result.prediction)
    yield from forecast.figures(result.forecast)
    if result.identifiability is not None:
        yield _rank(result.identifiability)
    if design is not None:
        yield from effects_sentences(design)
        yield from gain_sentences(design)
        yield from design_sentences(design)
    if result.estimate is not None:
        yield _fit(result.estimate, result.goodness)
    if result.posterior is not None:
        yield _posterior(result.posterior)


def noise_sentences(result: StudyResult) -> list[str]:
    """Where the noise of the readings departs from the stated one."""
    checked = result.goodness
    return [] if checked is None else noise_words(checked, result.gap)


def earlier_sentences(machine: MachineInfo) -> list[str]:
    """What the controller holds, and where the prior comes from."""
    phrases = []
    if machine.controller:
        phrases.append(
            f"The controller holds {machine.controller}: errors before compensation are"
            " those that it leaves."
        )
    if machine.earlier:
        phrases.append(
            f"The prior is the posterior of {machine.earlier}, not the tolerances."
        )
    if machine.fleet:
        count = len(machine.fleet)
        phrases.append(
            f"The prior is the mean and spread of {count} other"
            f" machine{'s' * (count > 1)}, not the tolerances."
        )
    return phrases


def _corrected(section: CorrectedSection) -> list[str]:
    """What compensation of parameters and effects reaches, and on which conditions."""
    if section.prediction is None:
        return []
    effects = join_words([plain_name(name) for name in section.constants])
    reference = REFERENCES[section.prediction.reference]
    return [
        f"With {effects} in the model, compensation of parameters and effects is"
        f" predicted to {_changes(section.prediction, f'the rms error, {reference}')}."
        f" It rests on these conditions: {'; '.join(section.conditions)}."
    ]


def _accuracy(section: PredictionSection) -> str:
    error = f"the rms error over the workspace, {REFERENCES[section.reference]}"
    others = _undriven(section)
    return f"Compensation is predicted to {_changes(section, error)}.{others}"


def _changes(section: PredictionSection, error: str) -> str:
    """What becomes of an error in the components that the controller corrects.

    What stays as it is, or grows, is not said to be reduced.
    """
    driven = {name: c for name, c in section.components.items() if c.compensatable}
    reduced: list[str] = []
    same: list[str] = []
    grown: list[str] = []
    for name, c in driven.items():
        unit = section.unit[name]
        before, after = c.before.rms, c.after.rms
        if format_number(before) == format_number(after):
            same.append(f"{name} {format_number(after)} {unit}")
        else:
            group = reduced if after < before else grown
            group.append(_change(name, before, after, unit))
    phrases = [f"reduce {error}: {'; '.join(reduced)}"] if reduced else []
    of = "" if reduced else f" {error}"
    if same:
        phrases.append(f"leave{of} as it is: {'; '.join(same)}")
        of = ""
    if grown:
        phrases.append(f"increase{of or ' it'}: {'; '.join(grown)}")
    return ", and to ".join(phrases) or f"change nothing of {error}"


def _undriven(section: PredictionSection) -> str:
    """What no drive corrects, without and with additional axes; empty where there is none."""
    parts = [
        f"{name} {format_number(c.after.rms)} {section.unit[name]}"
        f" ({format_number(c.known.rms)} {section.unit[name]} with additional axes)"
        for name, c in section.components.items()
        if not c.compensatable
    ]
    return f" No drive corrects {'; '.join(parts)}." if parts else ""


def _wanted(result: StudyResult) -> list[str]:
    """Each wanted accuracy against the predicted one, and the verdict on it."""
    verdicts = accuracy_verdicts(result)
    section = result.judged_prediction
    if section is None or not verdicts:
        return []
    parts = [
        verdict.sentence(name, v, format_number(v.rms), format_number(v.wanted))
        for name, v in verdicts.items()
    ]
    scopes = join_words(list(dict.fromkeys(v.scope for v in verdicts.values())))
    undriven = [
        f" {name} has no drive and is judged by its unknown part."
        for name in verdicts
        if not section.components[name].compensatable
    ]
    decide = dict.fromkeys(v.decide for v in verdicts.values() if v.decide)
    return [
        f"Wanted accuracy, predicted against wanted ({scopes}): {'; '.join(parts)}."
        + "".join(undriven)
        + "".join(f" To decide: {phrase}." for phrase in decide)
    ]


def _unmodelled(section: PredictionSection | None) -> list[str]:
    """What an effect outside the model would do to a planned machine."""
    if section is None or section.budget is None:
        return []
    driven = {
        n: section.unit[n] for n, c in section.components.items() if c.compensatable
    }
    after = {name: section.components[name].after.rms for name in driven}
    sentence = unmodelled_sentence(section.budget, after, driven)
    return [] if sentence is None else [sentence]


def unmodelled_sentence(
    section: BudgetSection, after: Mapping[str, float], driven: Mapping[str, str]
) -> str | None:
    """What the effect that adds most does to the accuracy, and the remedy.

    after   rms error of each component with geometry alone
    driven  {component: unit} of those that the controller corrects
    """
    if not section.unmodelled:
        return None
    worst = section.unmodelled[0]
    usual = section.usual
    opening = f"This is geometry alone ({error_quantities(after, driven)})."
    counted = ""
    if usual is not None and usual.components:
        errors = {name: usual.components[name].after.rms for name in driven}
        number = len(usual.effects)
        acting = f"all {number} usual effects" if number > 1 else "the usual effect"
        counted = (
            f" With {acting} at the expected size, fitted beside the geometry, the"
            f" parameters sent leave {error_quantities(errors, driven)}; with effects"
            f" corrected too {error_quantities(usual.fitted, driven)}."
        )
    return (
        f"{opening}{counted} Most is {worst.effect} of its expected size"
        f" ({worst.expected}), which can be ten times larger or smaller. Remedy: {worst.remedy}."
    )


def _rank(section: IdentifiabilitySection) -> str:
    verdict = f"The readings determine {section.rank} of {section.n} parameters"
    lost = section.n - section.rank
    if not lost:
        return f"{verdict}."
    directions = "1 direction stays" if lost == 1 else f"{lost} directions stay"
    return (
        f"{verdict}; {directions} undetermined. The report names readings that would"
        " determine them."
    )


def _fit(section: EstimateSection, checked: GoodnessSection | None) -> str:
    changes = [
        _change(channel, section.rms_before[channel], after, section.units[channel])
        for channel, after in section.rms_after.items()
    ]
    aside = ""
    if checked is not None and checked.outliers:
        aside = f",{checked.fit_words},"
    return (
        f"The fit of {section.readings} readings{aside} changes their rms residual:"
        f" {'; '.join(changes)}."
    )


def _posterior(section: PosteriorSection) -> str:
    marginals = section.marginals.values()
    ess = min((m.ess for m in marginals if m.ess is not None), default=math.nan)
    size = f"an effective sample size of at least {float(f'{ess:.2g}'):.0f}"
    if section.sampler == PosteriorSection.IMPORTANCE:
        return f"The posterior has {section.draws} draws by weight, {size}."
    rhat = max((m.rhat for m in marginals if m.rhat is not None), default=math.nan)
    return (
        f"The posterior has {section.draws} draws, {size} and an R-hat of at most"
        f" {rhat:.3f}."
    )


def predicted_accuracy(section: PredictionSection | None) -> dict[str, float]:
    """Predicted rms of each component after the plan, by component and fine unit."""
    if section is None:
        return {}
    return {
        f"{name}_{section.unit[name]}": component.after.rms
        for name, component in section.components.items()
    }


def _change(name: str, before: float, after: float, unit: str) -> str:
    if format_number(before) == format_number(after):
        return f"{name} stays at {format_number(after)} {unit}"
    return f"{name} from {format_number(before)} to {format_number(after)} {unit}"


# -- what else to record ---------------------------------------------------------------
def recording_sentences(*sections: PlanSection | DesignSection | None) -> list[str]:
    """What else to record beside the plans, the best first; none without effects."""
    sentences = []
    for section in sections:
        effects = None if section is None else section.effects
        recording = None if effects is None else effects.recording
        choices = [] if recording is None else recording.choices
        parts = []
        for choice in [c for c in choices if c.gain >= MIN_GAIN][:MAX_NAMED_CHOICES]:
            worth = "as no number of further readings does without"
            if choice.readings is not None:
                worth = f"worth {choice.readings} further readings"
            share = percent(choice.gain)
            parts.append(f"{choice.words} (errors {share} smaller, {worth})")
        if parts:
            sentences.append(f"What else to record: {'; '.join(parts)}.")
    return sentences


# What a terminal prints of a result, and the exit code.

MAX_LINES: Final = 12  #: lines of a summary, which a terminal shows without scrolling
MAX_BARE_SENTENCES: Final = 3  #: sentences of a result that has no first lines
CONTRADICTS: Final = "contradicts"  #: the one that is never summed up
#: names of the files that a user opens
PAGES: Final = ("report.html", "report.pdf", "result.json")


def lines(
    result: StudyResult, folder: Path, verbose: bool, above: Sequence[str] = ()
) -> list[str]:
    """The first lines of the report, what speaks against them, files and claims.

    At most MAX_LINES lines, but for what speaks against the result; `verbose` prints
    every sentence, warning and claim.
    """
    from pkm_reports import first_lines

    page = first_lines(result)
    table = [] if page.table is None else _table(page.table)
    shown = [*above, *(page.sentences or result.headline[:MAX_BARE_SENTENCES]), *table]
    files = _files(result, folder, page.is_plan)
    if verbose:
        warnings = _warnings(result, folder)
        claims = [f"Claim {claim_verdict(claim)}" for claim in result.claims]
        rest = [line for line in result.headline if line not in shown]
        return [*shown, *rest, *warnings, *files, *claims]
    contradictions = [
        f"{s.words}." for s in result.held_out if s.verdict == CONTRADICTS
    ]
    failing = [
        f"Claim {claim_verdict(claim)}" for claim in result.claims if not claim.met
    ]
    of_files = [w for w in page.warnings if result_folder.CHANGED in w]
    of_files += result_folder.changed_files(folder)
    others = [w for w in page.warnings if w not in of_files]
    identified = result.identifiability
    # the most useful first, where not all have room
    ranked = [
        *[f"Next: {action}" for action in page.actions],
        *page.findings[:1],
        *(
            [_rank(identified)]
            if identified is not None and identified.rank < identified.n
            else []
        ),
        *[f"Warning: {_sentence(warning)}" for warning in others],
        *noise_sentences(result),
        *earlier_sentences(result.machine),
        *page.findings[1:],
    ]
    needed = [
        *contradictions,
        *[f"Warning: {_sentence(warning)}" for warning in of_files],
        *files,
        *failing,
    ]
    room = max(0, MAX_LINES - len(shown) - len(needed) - 1)
    return [*shown, *ranked[:room], *needed, _last_line(result, len(ranked[room:]))]


def _table(table: Table) -> list[str]:
    """A table of the report as lines; the sentence above says what it is of."""
    from rich.table import Table as Lines

    drawn = Lines(box=None, show_header=True, padding=(0, 1))
    for column in table.columns:
        drawn.add_column(column.title, justify="right" if column.number else "left")
    for row in table.rows:
        drawn.add_row(*row)
    return console.table_lines(drawn)


def _warnings(result: StudyResult, folder: Path) -> list[str]:
    """Warnings that the headline does not state, and files that stay."""
    stated = [
        sentence for sentence in result.warnings if sentence not in result.headline
    ]
    sentences = [*stated, *result_folder.changed_files(folder)]
    return [f"Warning: {_sentence(sentence)}" for sentence in sentences]


def _files(result: StudyResult, folder: Path, is_plan: bool) -> list[str]:
    """The files that a user opens, and those of a plan to fill in."""
    paths = [safe_files.latest(folder / name) for name in PAGES]
    sheets = [name for name in result.written if name.startswith("poses") and is_plan]
    return [
        f"Report: {', '.join(str(p) for p in paths if p.is_file())}",
        *[f"To fill in: {folder / name}" for name in sheets],
    ]


def _last_line(result: StudyResult, more: int) -> str:
    """How many claims are met, and where the lines are that have no room."""
    claims = ""
    if result.claims:
        met = sum(claim.met for claim in result.claims)
        claims = f"Claims: {met} of {len(result.claims)} met. "
    rest = f" ({more} more line{'s' * (more > 1)})" if more else ""
    return f"{claims}--verbose prints every sentence, warning and claim{rest}."


def _sentence(text: str) -> str:
    """A capital first letter, and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


# What the command prints of a result, and the exit code.
def report_outcome(
    result: StudyResult,
    folder: Path,
    quiet: bool,
    *,
    verbose: bool = False,
    above: Sequence[str] = (),
) -> int:
    """Print headline, files and claims, below the lines `above`; the exit code.

    It is 0 where nothing speaks against the result and what is wanted passes.
    """
    if not quiet:
        print(*lines(result, folder, verbose, above), sep="\n")
    from oed import trust
    from oed.verdict import all_pass

    failing = [claim for claim in result.claims if not claim.met]
    for claim in failing:
        console.print_error(f"claim {claim_verdict(claim)}")
    objections = trust.objections(result)
    for objection in objections:
        console.print_error(
            f"{objection}: do not rely on its parameters, nor on what they predict"
        )
    passes = all_pass(v.judgement for v in result.verdicts.values())
    return DONE if passes and not failing and not objections else FAILED


def claim_verdict(claim: Claim) -> str:
    """What was claimed, and what was measured."""
    if claim.met and isinstance(claim.measured, str):
        return f"{claim.claim}: met: {claim.wanted}"
    measured = claim.measured
    if isinstance(measured, float):
        measured = f"{measured:.6g}"
    met = "met" if claim.met else "not met"
    return f"{claim.claim}: {met}: {claim.wanted}, measured {measured}"
