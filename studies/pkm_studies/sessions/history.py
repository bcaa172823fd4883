"""Drift of a machine over the results of its sessions, and when to calibrate again."""

import dataclasses
import datetime
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from oed import trust, units
from oed.base import Array
from oed.history import MachineSessions, SessionDrift
from oed.result import ParameterEstimate, StudyResult
from pkm_studies import files
from pkm_studies.acceptance import PromisedAccuracy
from pkm_studies.base import InputError, Stream
from pkm_studies.compensation import result_study
from pkm_studies.quantities import component_values
from pkm_studies.results import Estimated, estimated_section, load_result
from pkm_studies.user_code import Consent

# Compares the results of two sessions of one machine: what changed.


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
    sessions, units = sessions_of(results, folders)
    doubts = warnings(results, folders)
    return SessionReport([*doubts, *sessions.change().sentences(units)], not doubts)


def sessions_of(
    results: Sequence[StudyResult], folders: Sequence[Path]
) -> tuple[MachineSessions, dict[str, str]]:
    """The sessions of several results, and parameters' units. Raises InputError."""
    estimates = [estimated_section(r, f) for r, f in zip(results, folders, strict=True)]
    tables = [
        _machine_parameters(result, estimate)
        for result, estimate in zip(results, estimates, strict=True)
    ]
    for table, result, folder in zip(tables, results, folders, strict=True):
        _check_same([tables[0], table], [results[0], result], folder)
    names, shared = list(tables[0]), tables[0].values()
    sessions = MachineSessions.of(
        names,
        np.array([p.nominal for p in shared]),
        np.array([p.prior_sd for p in shared]),
        [_session(names, estimate) for estimate in estimates],
    )
    return sessions, {name: p.unit for name, p in tables[0].items()}


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
        section, estimate = estimated_section(result, folder), result.estimate
        readings = tuple(p.value for p in section.parameters.values())
        if estimate is not None and any(estimate.residuals_before):
            readings = tuple(estimate.residuals_before)
        if readings in first:
            raise InputError(
                f"this is the session of {first[readings]}: the readings are equal",
                "name each session once",
                file=str(folder / "result.json"),
            )
        first[readings] = folder


def _machine_parameters(
    result: StudyResult, estimate: Estimated
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


def _session(names: list[str], estimate: Estimated) -> tuple[Array, Array]:
    """Mean and covariance of the machine's parameters, marginal to the set-ups."""
    position = {name: k for k, name in enumerate(estimate.parameters)}
    rows = [position[name] for name in names]
    mean = np.array([estimate.parameters[name].value for name in names])
    return mean, np.array(estimate.covariance)[np.ix_(rows, rows)]


def write_comparison(folders: Sequence[Path], out: Path) -> tuple[Path, ...]:
    """HTML and PDF of the results in several folders side by side; their paths.

    Two results of one machine, with estimates under one prior, are also compared as
    `oed compare` does. Raises InputError where a folder holds no result.
    """
    from pkm_reports import write_comparison

    loaded = [load_result(folder) for folder in folders]
    results = dict(zip(short_names(folders), loaded, strict=True))
    changes = _changes(folders, loaded) if len(folders) == 2 else []
    files.make_folder(out)
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


DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
MIN_POWER = 0.9  #: probability of proving a drift that is called provable
#: limit of the rms error over that right after a calibration, where none is given
RMS_RATIO = 2.0


@dataclasses.dataclass(frozen=True)
class Sessions:
    """Results of one machine in order of time."""

    folders: tuple[Path, ...]
    results: tuple[StudyResult, ...]
    times: Array  #: (k,) days, or numbers of the sessions where no dates are known
    unit: str  #: `day` or `session`


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
    machine_sessions, shown = sessions_of(sessions.results, sessions.folders)
    drifted = machine_sessions.drift(sessions.times)
    doubts = warnings(sessions.results, sessions.folders)
    errors = _errors(sessions, shown, limits, study_file, consent)
    outlook = _provable(sessions, errors, machine_sessions)
    if drifted.is_proven:
        outlook = _due(sessions, errors, drifted)
    sentences = [
        *doubts,
        _sessions_text(sessions),
        *drifted.sentences(shown, sessions.unit),
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
    refuse_same_sessions(loaded, found_in)
    dates = [_date(path) for path in found_in]
    dated = [date for date in dates if date is not None]
    if len(dated) < len(dates):
        times = np.arange(len(found_in), dtype=float)
        order = np.arange(len(found_in))
        unit = "session"
    else:
        days = np.array([date.toordinal() for date in dated], dtype=float)
        order = np.argsort(days, kind="stable")
        times = days[order]
        unit = "day"
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
        problem = "there is no result.json here, nor in a folder of it"
        remedy = "make results with `oed identify STUDY --readings CSV --out DIR`"
        raise InputError(problem, remedy, file=str(folder))
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


# -- when to calibrate again -----------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class _Error:
    """The rms error of a component over the workspace."""

    name: str
    maps: Array  #: (m, n) pose errors over the shared parameters, SI
    unit: str  #: fine unit
    after: float  #: right after the last session, SI
    limit: float  #: at which to calibrate again, SI


def _errors(
    sessions: Sessions,
    shown: dict[str, str],
    limits: str,
    study_file: Path | None,
    consent: Consent,
) -> list[_Error]:
    """The error of each driven component, over the parameters in display units."""
    latest, folder = sessions.results[-1], sessions.folders[-1]
    study = result_study(latest, folder, study_file, consent)
    accuracy = PromisedAccuracy.from_result(latest, study, folder, {}, {})
    component_limits = component_values(limits, "--limit", accuracy.machine)
    columns = [accuracy.machine.index(name) for name in shown]
    factors = np.array([units.factor(unit) for unit in shown.values()])
    errors = []
    for k, component in enumerate(accuracy.components):
        after = float(accuracy.promise.rms[k])
        errors.append(
            _Error(
                name=component.name,
                maps=accuracy.promise.maps[:, k][:, columns] * factors,
                unit=units.FINE[component.unit],
                after=after,
                limit=component_limits.get(component.name, RMS_RATIO * after),
            )
        )
    return errors


def _due(
    sessions: Sessions, errors: Sequence[_Error], drifted: SessionDrift
) -> Iterator[str]:
    """When the rms error of each component reaches its limit."""
    rng = Stream.HISTORY.rng(sessions.results[-1].seed)
    for error in errors:
        due = drifted.next_calibration(error.maps, error.after, error.limit, rng)
        after, limit = (units.number(v, error.unit) for v in (error.after, error.limit))
        yield (
            f"{error.name}: rms {after:.3g} {error.unit} right after the last session;"
            f" {limit:.3g} {error.unit} are reached after {_time(due.time, sessions.unit)}"
            f" (95 %: {_time(due.low, sessions.unit)} to"
            f" {_time(due.high, sessions.unit)}). {_advice(sessions, due.low)}"
        )


def _provable(
    sessions: Sessions, errors: Sequence[_Error], machine_sessions: MachineSessions
) -> Iterator[str]:
    """How many sessions would prove a drift of which size."""
    count = len(sessions.folders)
    spacing = float(np.ptp(sessions.times)) / (count - 1)
    more = (count + 1, 2 * count, 4 * count)
    rng = Stream.HISTORY.rng(sessions.results[-1].seed)
    every = "" if sessions.unit == "session" else f", one every {spacing:.0f} days,"
    yield (
        f"There is no date for the next calibration. Sessions like these{every} prove with"
        f" probability {MIN_POWER:g} that an rms error grows a {sessions.unit} by"
    )
    for error in errors:
        growth = machine_sessions.provable_growth(error.maps, more, MIN_POWER, rng)
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
