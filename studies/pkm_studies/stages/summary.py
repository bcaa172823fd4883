"""Summarises a result for the terminal: what decides, in 25 lines, or every sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from oed import safe_files
from oed.text import format_number
from pkm_studies import console, result_folder
from pkm_studies.earlier_result import corrects_effects
from pkm_studies.results import improvements
from pkm_studies.stages import headline, outcome
from pkm_studies.stages.headline import REFERENCES, undriven_sentences
from pkm_studies.stages.plan.phrases import plan_sentences

if TYPE_CHECKING:
    from oed.result import PredictionSection, StudyResult, UsualEffects

# Writes the predicted accuracy as one table: before, after, what would change it.


class AccuracyRow(NamedTuple):
    """A line of the table: what it is, and the rms error by component."""

    words: str
    errors: Mapping[str, float]


def accuracy_lines(result: StudyResult) -> list[str]:
    """The table as lines, and what its rows mean; empty without accuracy."""
    prediction = result.judged_prediction
    if prediction is None or not prediction.components:
        return []
    from rich import box
    from rich.table import Table

    units = shown_components(prediction)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 1))
    table.add_column("")
    for name, unit in units.items():
        table.add_column(f"{name} [{unit}]", justify="right")
    for row in accuracy_rows(result, prediction):
        cells = [_cell(row.errors, name) for name in units]
        table.add_row(row.words, *cells)
    reference = REFERENCES[prediction.reference]
    return [
        f"Predicted rms error over the workspace, {reference}:",
        *console.table_lines(table),
        *accuracy_remarks(result, prediction),
    ]


def shown_components(prediction: PredictionSection) -> dict[str, str]:
    """{component: unit} of those that the controller corrects; all where it does none."""
    components = prediction.components
    driven = {n: c.after.unit for n, c in components.items() if c.compensatable}
    return driven or {n: c.after.unit for n, c in components.items()}


def accuracy_rows(
    result: StudyResult, prediction: PredictionSection
) -> list[AccuracyRow]:
    """The lines of the table."""
    components = prediction.components
    lines = [AccuracyRow("before", {n: c.before.rms for n, c in components.items()})]
    corrected = result.corrected
    if corrected is not None:
        alone = {n: s.rms for n, s in corrected.parameters_only.items()}
        lines.append(AccuracyRow("parameters compensated alone", alone))
    after = "after compensation"
    if corrects_effects(result):
        after = "effects compensated too"
    lines.append(AccuracyRow(after, {n: c.after.rms for n, c in components.items()}))
    budget = prediction.budget
    if budget is None and corrected is None and result.prediction is not None:
        budget = result.prediction.budget
    if budget is None:
        return lines
    for worst in budget.unmodelled[:1]:
        phrase = f"+ {worst.effect} of {worst.expected}, not in the model"
        lines.append(AccuracyRow(phrase, worst.with_it))
    if budget.usual is not None:
        lines += _usual_rows(budget.usual)
    units = shown_components(prediction)
    for phrase, better in improvements(budget.lines, budget.predicted, units):
        lines.append(AccuracyRow(f"with {phrase}", better))
    return lines


def _usual_rows(usual: UsualEffects) -> list[AccuracyRow]:
    """The machine with all usual effects, without and with them in the fit."""
    count = len(usual.effects)
    if count == 1:
        return [AccuracyRow("the same, in the fit and corrected", usual.fitted)]
    return [
        AccuracyRow(f"+ all {count} usual effects, not in the model", usual.unmodelled),
        AccuracyRow("the same, in the fit and corrected", usual.fitted),
    ]


def accuracy_remarks(result: StudyResult, prediction: PredictionSection) -> list[str]:
    """What the lines rest on, and the remedy for an effect that the model lacks."""
    others = undriven_sentences(prediction).strip()
    sentences = [others] if others else []
    if result.corrected is not None:
        conditions = "; ".join(result.corrected.conditions)
        sentences.append(f"This rests on these conditions: {conditions}.")
    budget = prediction.budget
    if budget is not None and budget.unmodelled:
        worst = budget.unmodelled[0]
        sentences.append(
            f"The prediction is geometry alone, without {worst.effect}: calibration takes"
            f" some of it for geometry, and sizes vary by decades. Remedy:"
            f" {worst.remedy}. Readings of the machine are asked which effects act."
        )
    return sentences


def _cell(errors: Mapping[str, float], name: str) -> str:
    return format_number(errors[name]) if name in errors else ""


#: lines of the terminal that a summary takes
MOST_LINES: Final = 25
#: names of the files that a user opens
PAGES: Final = ("report.html", "report.pdf", "result.json")


def lines(
    result: StudyResult, folder: Path, verbose: bool, above: Sequence[str] = ()
) -> list[str]:
    """Tables, findings, warnings, files and claims.

    A summary lacks details, and the fit's residuals where there is no room for them; its
    last line says so. Warnings, verdicts, files and claims
    that are not met are always there.
    """
    table = [*above, *accuracy_lines(result)]
    tabled = headline.accuracy_sentences(result)
    if above and result.plan is not None:
        tabled += [*plan_sentences(result.plan)[:1], " ".join(result.plan.needs)]
    findings = [sentence for sentence in result.headline if sentence not in tabled]
    rest = [*_warnings(result, folder), *_files(result, folder)]
    claims = [f"Claim {outcome.verdict(claim)}" for claim in result.claims]
    if verbose:
        return [*table, *findings, *rest, *claims]
    details = headline.detail_sentences(result)
    shown = [sentence for sentence in findings if sentence not in details]
    rest = [*_held_out(result), *rest, *_claims(result)]
    if _height([*table, *shown, *rest]) >= MOST_LINES:
        residuals = headline.fit_sentences(result)
        shown = [sentence for sentence in shown if sentence not in residuals]
    complete = len(findings) == len(shown) and not above and not result.claims
    more = [] if complete else ["--verbose prints every sentence and claim."]
    return [*table, *shown, *rest, *more]


def _height(printed: Sequence[str]) -> int:
    width = console.terminal().width
    return sum(console.height(line, width) for line in printed)


def _held_out(result: StudyResult) -> list[str]:
    """Channels of held-out readings that do not contradict the fit, in one sentence."""
    sections = [s for s in result.held_out if s.verdict in headline.FITTING]
    if not sections:
        return []
    confirming = sum(section.verdict == "confirms" for section in sections)
    inside = sorted(round(100.0 * section.coverage) for section in sections)
    phrase = f"{len(sections)} of {len(result.held_out)} channels agree with the fit"
    phrase += f", {confirming or 'none'} of them better than with the nominal numbers"
    ends = dict.fromkeys((inside[0], inside[-1]))
    shares = " to ".join(map(str, ends))
    return [
        f"Held-out readings: {phrase}; {shares} % of each are inside the predicted 95 %."
    ]


def _warnings(result: StudyResult, folder: Path) -> list[str]:
    """Warnings that the headline does not state, and files that stay."""
    stated = [
        sentence for sentence in result.warnings if sentence not in result.headline
    ]
    sentences = [*stated, *result_folder.changed_files(folder)]
    return [f"Warning: {_sentence(sentence)}" for sentence in sentences]


def _files(result: StudyResult, folder: Path) -> list[str]:
    """The files that a user opens, and those to fill in."""
    paths = [safe_files.latest(folder / name) for name in PAGES]
    sheets = [name for name in result.written if name.startswith("poses")]
    return [
        f"Report: {', '.join(str(p) for p in paths if p.is_file())}",
        *[f"To fill in: {folder / name}" for name in sheets],
    ]


def _claims(result: StudyResult) -> list[str]:
    """How many claims are met, and each that is not."""
    if not result.claims:
        return []
    failing = [claim for claim in result.claims if not claim.met]
    met = len(result.claims) - len(failing)
    return [
        f"Claims: {met} of {len(result.claims)} met.",
        *[f"Claim {outcome.verdict(claim)}" for claim in failing],
    ]


def _sentence(text: str) -> str:
    """A capital first letter, and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."
