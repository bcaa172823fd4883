"""Compares the results of two sessions of one machine: what changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from oed import trust
from oed.history import (
    P_EXPLAINED,
    Cause,
    CombinationChange,
    Session,
    SessionChange,
    compare_sessions,
)
from oed.result import CorrectedSection, EstimateSection, ParameterEstimate, StudyResult
from oed.text import format_p_value
from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.results import load_result

#: a section with parameters, their covariance and chi2
Fitted = EstimateSection | CorrectedSection
#: probability of a false alarm of a session's comparison
ALARM = 0.01
#: combinations and causes that are printed, and parameters of a combination
SHOWN, TERMS = 10, 4
#: departure from 1 of a coefficient that is written as 1
ONE = 5e-4


@dataclasses.dataclass(frozen=True)
class SessionReport:
    """What sessions say of a machine, and whether all their fits are to be trusted."""

    sentences: list[str]
    is_trusted: bool


def compare(before: Path, after: Path) -> SessionReport:
    """Sentences about what changed between the results in two folders.

    Raises InputError where a folder holds no estimate, or not of the same machine, and
    where both hold one session.
    """
    folders = (before, after)
    results = [load_result(folder) for folder in folders]
    refuse_same_sessions(results, folders)
    estimates = [_estimate(r, f) for r, f in zip(results, folders, strict=True)]
    tables = [
        _machine_parameters(result, estimate)
        for result, estimate in zip(results, estimates, strict=True)
    ]
    _check_same(tables, results, after)
    names = list(tables[0])
    shared = tables[0].values()
    change = compare_sessions(
        names,
        np.array([p.nominal for p in shared]),
        np.array([p.prior_sd for p in shared]),
        [_session(names, estimate) for estimate in estimates],
    )
    units = {name: p.unit for name, p in tables[0].items()}
    doubts = warnings(results, folders)
    return SessionReport([*doubts, *_sentences(change, units)], not doubts)


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


def warnings(results: Sequence[StudyResult], folders: Sequence[Path]) -> list[str]:
    """Warnings on the results whose fits are not to be trusted."""
    return [
        f"Warning: {folder} is not to be trusted: {'; '.join(objections)}. Its standard"
        " deviations are too small, and changes look more certain than they are."
        for result, folder in zip(results, folders, strict=True)
        if (objections := trust.objections(result))
    ]


def refuse_same_sessions(
    results: Sequence[StudyResult], folders: Sequence[Path]
) -> None:
    """Raises InputError where two folders hold one session: equal readings."""
    first: dict[tuple[float, ...], Path] = {}
    for result, folder in zip(results, folders, strict=True):
        readings = _readings_of(_estimate(result, folder), result.estimate)
        if readings in first:
            raise InputError(
                f"this is the session of {first[readings]}: the readings are equal",
                "name each session once",
                file=str(folder / "result.json"),
            )
        first[readings] = folder


def _readings_of(final: Fitted, estimate: EstimateSection | None) -> tuple[float, ...]:
    """What tells the readings of sessions apart: deviations from the nominal machine."""
    if estimate is not None and any(estimate.residuals_before):
        return tuple(estimate.residuals_before)
    return tuple(p.value for p in final.parameters.values())


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


def _sentences(change: SessionChange, units: Mapping[str, str]) -> Iterator[str]:
    """The test, parameters that explain the change, and the combinations."""
    if not change.dof:
        yield "The two sessions determine no common combination of parameters."
        return
    verdict = "No change" if change.p_value >= ALARM else "The machine changed"
    yield (
        f"{verdict}: chi2 {change.chi2:.4g} for {change.dof} combinations that both"
        f" sessions determine, p {format_p_value(change.p_value)}."
    )
    if change.undetermined:
        verb = "is" if change.undetermined == 1 else "are"
        yield (
            f"{change.undetermined} of {len(units)} directions {verb} not determined by"
            " both sessions: a change there stays unseen."
        )
    if change.p_value < ALARM:
        yield from explanations(change.causes, units)
    # Sidak: the smallest of dof p-values, each uniform where nothing changed
    threshold = 1.0 - (1.0 - ALARM) ** (1.0 / change.dof)
    yield f"Changes (* beyond chance among {change.dof}, at {ALARM:g}):"
    for combination in change.combinations[:SHOWN]:
        mark = "*" if combination.p_value < threshold else " "
        yield f"  {mark} {_combination(combination, units)}"


def _combination(combination: CombinationChange, units: Mapping[str, str]) -> str:
    phrase, unit = combination_words(combination, units)
    z = combination.change / combination.sd
    return (
        f"{phrase}: {combination.change:+.4g} {unit}, sd {combination.sd:.2g} {unit},"
        f" {z:+.1f} sd"
    )


def combination_words(
    combination: CombinationChange, units: Mapping[str, str]
) -> tuple[str, str]:
    """A combination in words, `z2 less 0.5 times z1`, and the unit of its pivot."""
    (pivot, _), *others = combination.coefficients.items()
    phrases = [pivot]
    for name, coefficient in others[: TERMS - 1]:
        sign = "less" if coefficient < 0.0 else "plus"
        amount = _amount(abs(coefficient), units[pivot], units[name])
        phrases.append(f"{sign} {amount}{name}")
    if len(others) >= TERMS:
        phrases.append(f"and {len(others) - TERMS + 1} smaller terms")
    return " ".join(phrases), units[pivot]


def _amount(size: float, unit: str, of_unit: str) -> str:
    """A coefficient in words that end before the parameter's name; nothing for 1."""
    if unit != of_unit:
        return f"{size:.3g} {unit} per {of_unit} of "
    return "" if abs(size - 1.0) < ONE else f"{size:.3g} times "


def explanations(
    causes: Sequence[Cause], units: Mapping[str, str], per: str = ""
) -> Iterator[str]:
    """Parameters whose change explains all of it, or that no two do; `per`: a time."""
    enough = [cause for cause in causes if cause.p_value >= P_EXPLAINED]
    if not enough:
        yield "No single parameter explains the change, nor do two."
        return
    count = "one parameter" if len(enough[0].changes) == 1 else "two parameters"
    yield f"A change of {count} alone explains all of it:"
    for cause in enough[:SHOWN]:
        yield f"    {_cause(cause, units, per)}"


def _cause(cause: Cause, units: Mapping[str, str], per: str) -> str:
    parts = [
        f"{name}: {change:+.4g} {units[name]}{per}, sd {cause.sds[name]:.2g} {units[name]}"
        for name, change in cause.changes.items()
    ]
    rest = f"chi2 falls to {cause.chi2:.4g}, p {format_p_value(cause.p_value)}"
    return f"{' and '.join(parts)}; {rest}"


def write_comparison(folders: Sequence[Path], out: Path) -> tuple[Path, ...]:
    """HTML and PDF of the results in several folders side by side; their paths.

    Two results of one machine, with estimates under one prior, are also compared as
    `oed compare` does. Raises InputError where a folder holds no result.
    """
    from pkm_reports import write_comparison

    loaded = [load_result(folder) for folder in folders]
    results = dict(zip(short_names(folders), loaded, strict=True))
    changes = _changes(folders, loaded) if len(folders) == 2 else []
    files.out_folder(out)
    return write_comparison(results, out, changes)


def short_names(folders: Sequence[Path]) -> list[str]:
    """A different name for each folder: its last parts, as few as tell them apart."""
    parts = [folder.resolve().parts for folder in folders]
    most = max(map(len, parts))
    for count in range(1, most + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{'/'.join(p[-1:])} ({k})" for k, p in enumerate(parts, 1)]


def _changes(folders: Sequence[Path], results: Sequence[StudyResult]) -> list[str]:
    """What changed between two sessions; nothing where they cannot be compared."""
    if results[0].machine.name != results[1].machine.name:
        return []
    if any(r.final_estimate is None for r in results):
        return []
    try:
        return compare(*folders).sentences
    except InputError:
        return []
