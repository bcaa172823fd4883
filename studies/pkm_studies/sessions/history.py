"""Drift of a machine over the results of its sessions, and when to calibrate again."""

from __future__ import annotations

import dataclasses
import datetime
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from oed import units
from oed.base import Array
from oed.history import (
    CombinationChange,
    Session,
    SessionDrift,
    estimate_drift,
    next_calibration,
    provable_growth,
)
from oed.result import ParameterEstimate, StudyResult
from oed.text import format_p_value
from pkm_studies.acceptance import promised_accuracy
from pkm_studies.base import InputError, Stream
from pkm_studies.compensation import result_study
from pkm_studies.quantities import component_values
from pkm_studies.results import load_result
from pkm_studies.sessions import comparison
from pkm_studies.sessions.comparison import SessionReport
from pkm_studies.user_code import Consent

DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
#: probability of a false alarm
ALARM = 0.01
#: probability of proving a drift that is called provable
POWER = 0.9
#: combinations that are printed
SHOWN = 10
#: p-value of no drift from which a combination is not shown: its 95 % interval has 0
DOUBTFUL = 0.05
#: limit of the rms error over that right after a calibration, where none is given
LIMIT = 2.0


@dataclasses.dataclass(frozen=True)
class Sessions:
    """Results of one machine in order of time.

    times  (k,) days, or numbers of the sessions where no dates are known
    unit   `day` or `session`
    """

    folders: tuple[Path, ...]
    results: tuple[StudyResult, ...]
    times: Array
    unit: str


def machine_history(
    folders: Sequence[Path],
    limits: str = "",
    study_file: Path | None = None,
    consent: Consent = Consent.RECORDED,
) -> SessionReport:
    """Sentences on the drift over the sessions in folders of results.

    folders     results, or folders of results; dates (2026-11-24) in their names count
    limits      `z_um=30,theta_arcsec=20`: rms errors at which to calibrate again; twice
                those right after a calibration by default
    study_file  study, where it names a machine in a file of its own
    consent     to run that file

    Raises InputError for fewer than two sessions, for one that is named twice, and for
    results of different machines.
    """
    sessions = _sessions(folders)
    names, table, posteriors = comparison.posteriors(sessions.results, sessions.folders)
    drifted = estimate_drift(
        names,
        np.array([p.nominal for p in table.values()]),
        np.array([p.prior_sd for p in table.values()]),
        posteriors,
        sessions.times,
    )
    shown = {name: p.unit for name, p in table.items()}
    doubts = comparison.warnings(sessions.results, sessions.folders)
    errors = _errors(sessions, names, shown, limits, study_file, consent)
    outlook = _provable(sessions, errors, table, posteriors)
    if drifted.p_value < ALARM:
        outlook = _due(sessions, errors, drifted)
    sentences = [
        *doubts,
        _sessions_text(sessions),
        *_verdict(drifted),
        *_causes(drifted, shown, sessions.unit),
        *_combinations(drifted, shown, sessions.unit),
        *(outlook if drifted.dof else ()),
    ]
    return SessionReport(sentences, not doubts)


def _sessions(folders: Sequence[Path]) -> Sessions:
    """The results of all folders in order of time. Raises InputError."""
    found_in = [path for folder in folders for path in _result_folders(folder)]
    if len(found_in) < 2:
        raise InputError(
            f"a history needs two sessions or more, here are {len(found_in)}",
            "name folders with a result.json, or a folder that holds them",
        )
    loaded = [load_result(path) for path in found_in]
    comparison.refuse_same_sessions(loaded, found_in)
    dates = [_date(path) for path in found_in]
    dated = [date for date in dates if date is not None]
    if len(dated) < len(dates):
        times = np.arange(len(found_in), dtype=float)
        order = np.arange(len(found_in))
        unit = "session"
    else:
        days = np.array([date.toordinal() for date in dated], dtype=float)
        order = np.argsort(days, kind="stable")
        times, unit = days[order], "day"
        if np.ptp(times) == 0.0:
            raise InputError(
                "all sessions have one date", "name the folders by their dates"
            )
    ordered = tuple(found_in[k] for k in order)
    return Sessions(ordered, tuple(loaded[k] for k in order), times, unit)


def _result_folders(folder: Path) -> list[Path]:
    """The folder itself, or those within it, that hold a result."""
    if (folder / "result.json").is_file():
        return [folder]
    inside = sorted(path.parent for path in folder.glob("*/result.json"))
    if not inside:
        raise InputError(
            "there is no result.json here, nor in a folder of it",
            "make results with `oed identify STUDY --readings CSV --out DIR`",
            file=str(folder),
        )
    return inside


def _date(path: Path) -> datetime.date | None:
    """The date in a folder's name, None without one."""
    match = DATE.search(path.name)
    if match is None:
        return None
    try:
        return datetime.date.fromisoformat(match.group())
    except ValueError:
        return None


def _sessions_text(sessions: Sessions) -> str:
    span = float(np.ptp(sessions.times))
    count = len(sessions.folders)
    if sessions.unit == "day":
        return f"{count} sessions over {span:.0f} days."
    return f"{count} sessions without dates in their folders' names: drift per session."


def _verdict(drifted: SessionDrift) -> Iterator[str]:
    """Whether the machine drifts, and whether evenly."""
    if not drifted.dof:
        yield "The sessions determine the drift of no combination of parameters."
        return
    verdict = "The machine drifts" if drifted.p_value < ALARM else "No drift is proven"
    yield (
        f"{verdict}: chi2 {drifted.chi2:.4g} for {drifted.dof} combinations, p"
        f" {format_p_value(drifted.p_value)}."
    )
    if drifted.widening > 1.0:
        yield (
            f"The sessions do not lie on a line (chi2 {drifted.rest:.4g} for"
            f" {drifted.rest_dof}): all intervals are {drifted.widening:.2g} times as"
            " wide. `oed compare` shows between which sessions the machine changed."
        )
    if drifted.undetermined:
        count = drifted.undetermined
        directions = "1 direction is" if count == 1 else f"{count} directions are"
        yield f"{directions} not determined: a drift there stays unseen."


def _causes(drifted: SessionDrift, shown: dict[str, str], unit: str) -> Iterator[str]:
    """Parameters whose drift explains all of a proven one."""
    if drifted.dof and drifted.p_value < ALARM:
        yield from comparison.explanations(drifted.causes, shown, f" a {unit}")


def _combinations(
    drifted: SessionDrift, shown: dict[str, str], unit: str
) -> Iterator[str]:
    if not drifted.dof:
        return
    yield f"Drift a {unit}, with its 95 % interval:"
    proven = [c for c in drifted.combinations if c.p_value < DOUBTFUL]
    for combination in (proven or drifted.combinations[:1])[:SHOWN]:
        yield f"  {_line(combination, shown, unit)}"


def _line(combination: CombinationChange, shown: dict[str, str], unit: str) -> str:
    phrase, of = comparison.combination_words(combination, shown)
    half = 1.96 * combination.sd
    low, high = combination.change - half, combination.change + half
    return f"{phrase}: {combination.change:+.3g} {of}, {low:+.3g} to {high:+.3g}"


# -- when to calibrate again -----------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Error:
    """The rms error of a component over the workspace.

    maps   (m, n) pose errors over the shared parameters, SI
    unit   fine unit
    after  right after the last session, SI
    limit  at which to calibrate again, SI
    """

    name: str
    maps: Array
    unit: str
    after: float
    limit: float


def _errors(
    sessions: Sessions,
    names: Sequence[str],
    shown: dict[str, str],
    limits: str,
    study_file: Path | None,
    consent: Consent,
) -> list[_Error]:
    """The error of each component that the controller corrects.

    Its maps are over the parameters in the units of their estimates.
    """
    latest, folder = sessions.results[-1], sessions.folders[-1]
    study = result_study(latest, folder, study_file, consent)
    accuracy = promised_accuracy(latest, study, str(folder / "result.json"), {}, {})
    component_limits = component_values(limits, "--limit", accuracy.machine)
    columns = [accuracy.machine.index(name) for name in names]
    factors = np.array([units.factor(shown[name]) for name in names])
    errors = []
    for k, component in enumerate(accuracy.components):
        after = float(accuracy.promise.rms[k])
        errors.append(
            _Error(
                name=component.name,
                maps=accuracy.promise.maps[:, k][:, columns] * factors,
                unit=units.FINE[component.unit],
                after=after,
                limit=component_limits.get(component.name, LIMIT * after),
            )
        )
    return errors


def _due(
    sessions: Sessions, errors: Sequence[_Error], drifted: SessionDrift
) -> Iterator[str]:
    """When the rms error of each component reaches its limit."""
    rng = Stream.HISTORY.rng(sessions.results[-1].seed)
    for error in errors:
        due = next_calibration(error.maps, drifted, error.after, error.limit, rng)
        after, limit = (units.number(v, error.unit) for v in (error.after, error.limit))
        yield (
            f"{error.name}: rms {after:.3g} {error.unit} right after the last session;"
            f" {limit:.3g} {error.unit} are reached after {_time(due.time, sessions.unit)}"
            f" (95 %: {_time(due.low, sessions.unit)} to"
            f" {_time(due.high, sessions.unit)}). {_advice(sessions, due.low)}"
        )


def _provable(
    sessions: Sessions,
    errors: Sequence[_Error],
    table: Mapping[str, ParameterEstimate],
    posteriors: Sequence[Session],
) -> Iterator[str]:
    """How many sessions would prove a drift of which size."""
    count = len(sessions.folders)
    spacing = float(np.ptp(sessions.times)) / (count - 1)
    more = (count + 1, 2 * count, 4 * count)
    rng = Stream.HISTORY.rng(sessions.results[-1].seed)
    every = "" if sessions.unit == "session" else f", one every {spacing:.0f} days,"
    yield (
        f"There is no date for the next calibration. Sessions like these{every} prove with"
        f" probability {POWER:g} that an rms error grows a {sessions.unit} by"
    )
    for error in errors:
        growth = provable_growth(
            error.maps,
            posteriors,
            np.array([p.nominal for p in table.values()]),
            np.array([p.prior_sd for p in table.values()]),
            more,
            ALARM,
            POWER,
            rng,
        )
        sizes = units.from_si(growth, error.unit) / spacing
        parts = [
            f"{size:.2g} {error.unit} ({number} sessions)"
            for size, number in zip(sizes, more, strict=True)
        ]
        yield f"  {error.name}: {', '.join(parts)}"


def _time(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "no time"
    count = f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
    return f"{count} {unit}s"


def _advice(sessions: Sessions, earliest: float) -> str:
    """The date until which the accuracy is 97.5 % sure."""
    if earliest <= 0.0:
        return "Calibrate now."
    if sessions.unit != "day" or earliest > datetime.date.max.toordinal() - 800_000:
        return f"Calibrate again within {_time(earliest, sessions.unit)}."
    last = int(sessions.times[-1])
    day = datetime.date.fromordinal(last + int(earliest))
    return f"Calibrate again by {day.isoformat()}."
