"""Compares the results of two sessions of one machine: what changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import special

from oed import session_change
from oed.result import (
    CorrectedSection,
    EstimateSection,
    ParameterEstimate,
    StudyResult,
)
from oed.session_change import CombinationChange, Session, SessionChange, SingleCause
from pkm_studies import result_folder
from pkm_studies.errors import InputError

#: a section with parameters, their covariance and chi2
Fitted = EstimateSection | CorrectedSection
#: probability of a false alarm of a session's comparison, and of the warning of a fit
ALARM, BAD_FIT = 0.01, 1e-3
#: combinations and causes that are printed, and parameters of a combination
SHOWN, TERMS = 10, 4


def compare(before: Path, after: Path) -> list[str]:
    """Sentences about what changed between the results in two folders.

    Raises InputError where a folder holds no estimate, or not of the same machine.
    """
    folders = (before, after)
    results = [result_folder.load_result(folder) for folder in folders]
    estimates = [_estimate(r, f) for r, f in zip(results, folders, strict=True)]
    tables = [
        _machine_parameters(result, estimate)
        for result, estimate in zip(results, estimates, strict=True)
    ]
    _check_same(tables, results, after)
    names = list(tables[0])
    shared = tables[0].values()
    change = session_change.compare(
        names,
        np.array([p.nominal for p in shared]),
        np.array([p.prior_sd for p in shared]),
        [_session(names, estimate) for estimate in estimates],
    )
    units = {name: p.unit for name, p in tables[0].items()}
    warnings = [_bad_fit(e, f) for e, f in zip(estimates, folders, strict=True)]
    return [*filter(None, warnings), *_sentences(change, units)]


def posteriors(
    results: Sequence[StudyResult], folders: Sequence[Path]
) -> tuple[list[str], dict[str, ParameterEstimate], list[Session]]:
    """Names, table and posteriors of the machine's parameters in several results.

    Raises InputError where a folder holds no estimate, or not of the same machine.
    """
    estimates = [_estimate(r, f) for r, f in zip(results, folders, strict=True)]
    tables = [
        _machine_parameters(result, estimate)
        for result, estimate in zip(results, estimates, strict=True)
    ]
    for table, result, folder in zip(tables, results, folders, strict=True):
        _check_same([tables[0], table], [results[0], result], folder)
    names = list(tables[0])
    return names, tables[0], [_session(names, estimate) for estimate in estimates]


def bad_fits(results: Sequence[StudyResult], folders: Sequence[Path]) -> list[str]:
    """Warnings on the results that do not fit their readings."""
    pairs = zip(results, folders, strict=True)
    return [w for r, f in pairs if (w := _bad_fit(_estimate(r, f), f)) is not None]


def _estimate(result: StudyResult, folder: Path) -> Fitted:
    """The corrected estimate where there is one, which effects do not bend."""
    estimate = result.final_estimate
    if estimate is None or not estimate.covariance:
        raise InputError(
            "this result has no estimate with its covariance",
            "make it with `oed identify`",
            file=str(folder / "result.json"),
        )
    return estimate


def _machine_parameters(
    result: StudyResult, estimate: Fitted
) -> dict[str, ParameterEstimate]:
    """The machine's parameters that are not fixed; set-ups are mounted anew."""
    names = {str(row["name"]) for row in result.machine.parameters}
    return {n: p for n, p in estimate.parameters.items() if n in names}


def _check_same(
    tables: list[dict[str, ParameterEstimate]], results: list[StudyResult], after: Path
) -> None:
    """Raises InputError unless both are of one machine under one prior."""
    first, second = (
        {name: (p.nominal, p.prior_sd, p.unit) for name, p in table.items()}
        for table in tables
    )
    names = [result.machine.name for result in results]
    if names[0] != names[1]:
        problem = f"this is the machine {names[1]}, the other is {names[0]}"
    elif first == second:
        return
    else:
        differing = sorted(
            name for name in {*first, *second} if first.get(name) != second.get(name)
        )
        problem = f"nominal value or tolerance differ: {', '.join(differing)}"
    remedy = "compare two sessions of one machine with the same [machine] and [prior]"
    raise InputError(problem, remedy, file=str(after / "result.json"))


def _session(names: list[str], estimate: Fitted) -> Session:
    """The posterior of the machine's parameters, marginal to the set-ups."""
    position = {name: k for k, name in enumerate(estimate.parameters)}
    rows = [position[name] for name in names]
    mean = np.array([estimate.parameters[name].value for name in names])
    return Session(mean, np.array(estimate.covariance)[np.ix_(rows, rows)])


def _bad_fit(estimate: Fitted, folder: Path) -> str | None:
    """A warning where the readings do not fit: the deviations below are too small."""
    p_value = float(special.chdtrc(max(estimate.dof, 1e-9), estimate.chi2))
    if p_value >= BAD_FIT:
        return None
    return (
        f"Warning: {folder} does not fit its readings (chi2 {estimate.chi2:.4g} for"
        f" {estimate.dof:.4g} degrees of freedom): its standard deviations are too"
        " small, and changes look more certain than they are."
    )


def _sentences(change: SessionChange, units: Mapping[str, str]) -> Iterator[str]:
    """The test, the combinations, and single parameters that explain the change."""
    if not change.dof:
        yield "The two sessions determine no common combination of parameters."
        return
    verdict = "No change" if change.p_value >= ALARM else "The machine changed"
    yield (
        f"{verdict}: chi2 {change.chi2:.4g} for {change.dof} combinations that both"
        f" sessions determine, p = {change.p_value:.2g}."
    )
    if change.undetermined:
        yield (
            f"{change.undetermined} of {len(units)} directions are not determined by both"
            " sessions: a change there stays unseen."
        )
    # Sidak: the smallest of dof p-values, each uniform where nothing changed
    threshold = 1.0 - (1.0 - ALARM) ** (1.0 / change.dof)
    yield f"Changes (* beyond chance among {change.dof}, at {ALARM:g}):"
    for combination in change.combinations[:SHOWN]:
        mark = "*" if combination.p_value < threshold else " "
        yield f"  {mark} {_combination(combination, units)}"
    if change.p_value < ALARM:
        yield from _explanations(change, units)


def _combination(combination: CombinationChange, units: Mapping[str, str]) -> str:
    words, unit = combination_words(combination, units)
    z = combination.change / combination.sd
    return (
        f"{words}: {combination.change:+.4g} {unit}, sd {combination.sd:.2g} {unit},"
        f" {z:+.1f} sd"
    )


def combination_words(
    combination: CombinationChange, units: Mapping[str, str]
) -> tuple[str, str]:
    """A combination in words, and the unit of its pivot."""
    ordered = sorted(combination.coefficients.items(), key=lambda item: item[1] != 1.0)
    terms = [name if c == 1.0 else f"{c:+.3g} {name}" for name, c in ordered[:TERMS]]
    if len(ordered) > TERMS:
        terms.append(f"+ {len(ordered) - TERMS} more")
    return " ".join(terms), units[ordered[0][0]]


def _explanations(change: SessionChange, units: Mapping[str, str]) -> Iterator[str]:
    """Single parameters whose change explains all of it, or that none does."""
    enough = [cause for cause in change.causes if cause.p_value >= ALARM]
    if not enough:
        yield "No single parameter explains the change."
        return
    yield "A change of one parameter alone explains all of it:"
    for cause in enough[:SHOWN]:
        yield f"    {_cause(cause, units)}"


def _cause(cause: SingleCause, units: Mapping[str, str]) -> str:
    unit = units[cause.parameter]
    return (
        f"{cause.parameter}: {cause.change:+.4g} {unit}, sd {cause.sd:.2g} {unit};"
        f" chi2 falls to {cause.chi2:.4g}, p = {cause.p_value:.2g}"
    )
