"""Checks the readings of a session before they are fitted, and says what is wrong."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from oed.base import Index, Mask
from oed.checks import copies, sentences
from oed.checks.explain import Explanation, explain
from oed.checks.findings import PHYSICAL_KINDS, CheckFinding, Severity, listing
from oed.checks.fit import Goodness, fit, goodness
from oed.checks.judgement import Judgement, judge
from oed.checks.outlier_odds import FarReading
from oed.checks.outliers import OutlierSearch
from oed.checks.sentences import contradictions
from oed.checks.session import Ranges, SessionReadings
from oed.checks.times import wrong_times
from oed.dataset import ReadingsColumn, temperature_body
from oed.fit_limits import ALARM_PROBABILITY
from oed.measurement import Measurement
from oed.result import GoodnessSection, MistakeRecord, OutlierRecord

# Covariates that no workshop has: temperatures in kelvin, loads of a thousand tons.

#: least and largest value, SI, that machines work at, by the beginning of the name: a
#: body's temperature (C, or a difference), a speed (300 m/min), a load of 10 t, a tension
RANGES = {
    "temp_": (-60.0, 150.0),
    "feed": (0.0, 5.0),
    "payload": (0.0, 1e5),
    "tension_": (0.0, 1e6),
}
ZERO_CELSIUS = 273.15  #: 0 C in kelvin
COLDEST_KELVIN = 213.15  #: the lowest temperature at which machines work, K


def doubtful_conditions(session: SessionReadings) -> list[CheckFinding]:
    """Covariates outside the range that machines work at, by column and row."""
    findings = []
    frame = session.values.iloc[session.firsts]
    for column in filter(None, map(ReadingsColumn.from_covariate, frame.columns)):
        stem, name, factor = column.stem, column.name, column.factor
        limits = next((v for k, v in RANGES.items() if stem.startswith(k)), None)
        if limits is None:
            continue
        values = frame[stem].to_numpy(dtype=float)
        lower, upper = limits
        outside = np.isfinite(values) & ((values < lower) | (values > upper))
        if not outside.any():
            continue
        rows = session.rows(np.flatnonzero(outside))
        least, largest = values[outside].min(), values[outside].max()
        between = f"{least / factor:.6g}"
        if largest > least:
            between += f" to {largest / factor:.6g}"
        sentence = (
            f"{name} is {between} in {len(rows)} row{'s' if len(rows) > 1 else ''}"
            f" ({listing(rows)}), outside {lower / factor:.6g} to {upper / factor:.6g}"
            f" {name.removeprefix(f'{stem}_')}: {_cause(stem, least, largest, upper)}."
        )
        findings.append(CheckFinding(Severity.ORDER, "condition", sentence, rows))
    return findings


def _cause(stem: str, least: float, largest: float, upper: float) -> str:
    if temperature_body(stem):
        if least >= COLDEST_KELVIN and largest <= ZERO_CELSIUS + upper:
            return f"kelvin, not Celsius? Subtract {ZERO_CELSIUS}"
        if least < -ZERO_CELSIUS:
            return "nothing is below absolute zero; leave the cell empty where it is unknown"
        return "a sensor's mark of no value? Leave the cell empty where it is unknown"
    if least < 0.0:
        return "it cannot be negative; correct the sign, or leave the cell empty"
    if largest <= 1e3 * upper:
        return "in a finer unit than that of the column?"
    return "correct it, or leave the cell empty where it is unknown"


MIN_VALUES = 8  #: values from which on mistakes are tried: fewer fit too many of them
#: kinds of findings on how large the residuals are
FIT_KINDS = ("fit", "guess", "law", "too_small")
#: residuals over the stated noise from which on it is said that a law explains them
RATIO_BY_LAW = 2.0


@dataclasses.dataclass(frozen=True)
class CheckedSession:
    """A session with what its check found."""

    session: SessionReadings  #: the readings
    findings: tuple[CheckFinding, ...]  #: the most harmful first
    #: of the readings without those set aside and those in doubt; None where they have
    #: no fit
    goodness: Goodness | None
    #: readings far from what all others predict; None where they have no fit
    search: OutlierSearch | None
    #: mistakes that explain readings which do not fit
    explanations: tuple[Explanation, ...]
    #: the same by the stated noise, where an estimated law explains more; None elsewhere
    as_stated: Goodness | None = None

    @property
    def outliers(self) -> OutlierSearch | None:
        """Readings to set aside or in doubt; None where a mistake, or too many."""
        many = self.search is None or self.search.exhausted
        return None if many or self.explanations else self.search

    @property
    def explained_as_stated(self) -> bool:
        """Whether the stated noise explains the readings at parameters of its own."""
        return self.goodness is not None and self.goodness.p_high >= ALARM_PROBABILITY

    @property
    def judges_residuals(self) -> bool:
        """Whether a finding says how large the residuals are."""
        return any(finding.kind in FIT_KINDS for finding in self.findings)

    def with_goodness(
        self, fitted: Goodness, *, noise_is_a_guess: bool
    ) -> "CheckedSession":
        """The check with the figures of the fit that is delivered, and their findings.

        Where that fit does not use the law, the readings are judged by the check's.
        """
        checked = self.goodness
        if fitted.law_p_high is None and checked is not None:
            fitted = dataclasses.replace(
                fitted, law_p_low=checked.law_p_low, law_p_high=checked.law_p_high
            )
        findings = [f for f in self.findings if f.kind not in FIT_KINDS]
        of_fit = self.fit_findings(fitted, noise_is_a_guess=noise_is_a_guess)
        # at other parameters the stated noise may explain them
        is_stated = self.explained_as_stated
        findings += [f for f in of_fit if not (is_stated and f.kind == "law")]
        findings.sort(key=lambda finding: finding.severity)
        return dataclasses.replace(self, findings=tuple(findings), goodness=fitted)

    def fit_findings(
        self, fitted: Goodness | None, *, noise_is_a_guess: bool
    ) -> list[CheckFinding]:
        """How large the residuals of a fit are, where no mistake explains them."""
        search = self.search
        if self.explanations:
            return []
        if fitted is None or search is None:
            return [sentences.no_fit()]
        is_bad = fitted.is_bad(noise_is_a_guess=noise_is_a_guess)
        if is_bad or search.exhausted:
            return [sentences.too_large(self.session, fitted, search)]
        if fitted.ratio is None:
            return []
        if fitted.too_large:
            return [sentences.guessed(fitted.ratio, search)]
        if fitted.p_high < ALARM_PROBABILITY and fitted.ratio > RATIO_BY_LAW:
            return [sentences.explained_by_law(fitted, search)]
        if fitted.too_small:
            return [sentences.too_small(fitted, search)]
        return []

    def reading_findings(self, ranges: Ranges, outside: Index) -> list[CheckFinding]:
        """Outliers, and values outside (k,) their predicted range that are not named so."""
        session, outliers = self.session, self.outliers
        findings: list[CheckFinding] = []
        named: list[int] = []
        if outliers is not None:
            exchanged = _exchanged(session, outliers)
            findings += sentences.outliers(session, outliers, exchanged)
            named = [one.reading for one in outliers.far]
        left_over = outside[~np.isin(session.reading_of_value[outside], named)]
        if left_over.size:
            findings.append(sentences.outside(session, ranges, left_over))
        return findings

    @property
    def bad_fit(self) -> bool:
        """Whether nothing fitted to the readings can be trusted."""
        return any(f.severity <= Severity.BAD_FIT for f in self.findings)

    @property
    def mistaken(self) -> bool:
        """Whether the readings are likelier mistaken than changed by an effect.

        Some mistakes are what an effect of a machine does as well.
        """
        mimicked, others = 0.0, 0.0
        for one in self.explanations:
            if one.kind in PHYSICAL_KINDS:
                mimicked += one.probability
            else:
                others += one.probability
        return others > mimicked

    @property
    def doubtful_values(self) -> Mask:
        """Mask (N,) of doubtful readings among the values that are not set aside."""
        reading = self.session.reading_of_value
        doubtful = () if self.outliers is None else self.outliers.doubtful
        used = ~np.isin(reading, self.set_aside)
        return np.isin(reading, [one.reading for one in doubtful])[used]

    @property
    def set_aside(self) -> tuple[int, ...]:
        """Readings, by number, that a fit should leave out."""
        if self.outliers is None:
            return ()
        return tuple(sorted(self.outliers.readings))

    @property
    def section(self) -> GoodnessSection:
        """The check as the result holds it."""
        outliers = self.outliers
        none = GoodnessSection(None, None, None, None)
        unlocated = () if outliers is None else sorted(outliers.unlocated)
        return replace(
            none if self.goodness is None else self.goodness.section,
            bad_fit=self.bad_fit,
            outliers=self._records(() if outliers is None else outliers.gross),
            doubtful=self._records(() if outliers is None else outliers.doubtful),
            unlocated=[int(row) for row in self.session.rows(unlocated)],
            mistakes=[
                MistakeRecord(what=one.what, evidence=sentences.evidence(one))
                for one in self.explanations
            ],
            findings=[finding.sentence for finding in self.findings],
        )

    def _records(self, far: Sequence[FarReading]) -> list[OutlierRecord]:
        records = []
        for one in far:
            row = self.session.values.iloc[one.value]
            records.append(
                OutlierRecord(
                    setup=str(row["setup"]),
                    run=str(row["run"]),
                    order=int(row["order"]),
                    row=int(row["row"]),
                    file=self.session.file_of(one.value),
                    pull=one.pull,
                )
            )
        return records


def check_session(
    session: SessionReadings,
    measurement: Measurement,
    rng: np.random.Generator,
    *,
    noise_is_a_guess: bool = False,
    noise_is_estimated: bool = True,
) -> CheckedSession:
    """Check readings against tolerances, noise, the usual mistakes, and each other.

    `rng` draws machines where ranges are not linear. Where the noise law is estimated,
    what it holds is no misfit; of a guessed noise neither are residuals up to
    `oed.fit_limits.GUESS_RATIO` times as large. Raises AssemblyError.
    """
    ranges = session.predict_ranges(rng)
    outside = ranges.outside(session.y)
    suspects = np.unique(session.reading_of_value[outside])
    judgement = judge(
        session, suspects, estimated=noise_is_estimated, robust=noise_is_a_guess
    )
    fitted = judgement.fitted
    explanations = _explanations(session, measurement, judgement)
    if explanations:
        every = fit(session)
        fitted = None if every is None else goodness(every)
    checked = CheckedSession(
        session,
        (),
        fitted,
        judgement.outliers,
        tuple(explanations),
        None if explanations else judgement.as_stated,
    )
    findings = [
        *sentences.explained(explanations),
        *_copies(session, ranges),
        *sentences.contradicting(contradictions(session)),
        *wrong_times(session),
        *doubtful_conditions(session),
        *checked.fit_findings(fitted, noise_is_a_guess=noise_is_a_guess),
        *checked.reading_findings(ranges, outside),
    ]
    findings.sort(key=lambda finding: finding.severity)
    return dataclasses.replace(checked, findings=tuple(findings))


def _explanations(
    session: SessionReadings, measurement: Measurement, judgement: Judgement
) -> list[Explanation]:
    """Mistakes, where the readings without their outliers do not fit."""
    outliers, fitted = judgement.outliers, judgement.fitted
    is_small = judgement.stated and fitted is not None and fitted.too_small
    if len(session) < MIN_VALUES or (judgement.stated and not is_small):
        return []
    solution = None if outliers is None else outliers.rest
    if is_small:
        return explain(session, solution, measurement, of_noise=True)
    if not judgement.sound:
        return explain(session, solution, measurement)
    # what an effect can mimic, the noise law holds as well here
    likely = explain(session, solution, measurement, thorough=False)
    if likely and likely[0].kind in PHYSICAL_KINDS:
        return []
    return [one for one in likely if one.kind not in PHYSICAL_KINDS]


def _copies(session: SessionReadings, ranges: Ranges) -> list[CheckFinding]:
    findings = []
    computed = copies.computed_readings(session, ranges.nominal, ranges.sd)
    if computed.size:
        findings.append(sentences.computed(session, computed))
    else:
        equal = copies.equal_readings(session)
        if equal:
            findings.append(sentences.doubled(session, equal))
    between = copies.interpolated_readings(session)
    if between.size:
        findings.append(sentences.interpolated(session, between))
    findings += [
        sentences.coarse(session, one) for one in copies.coarse_columns(session)
    ]
    return findings


def _exchanged(
    session: SessionReadings, outliers: OutlierSearch
) -> tuple[int, int] | None:
    """Two outliers that fit where the other one stands, by number."""
    numbers = [one.reading for one in outliers.far]
    if not 2 <= len(numbers) <= 6:
        return None
    reading = session.reading_of_value
    for pair in itertools.combinations(numbers, 2):
        one, other = (np.flatnonzero(reading == k) for k in pair)
        y = session.y.copy()
        if len(one) != len(other):
            continue
        y[one], y[other] = session.y[other], session.y[one]
        rest = [k for k in numbers if k not in pair]
        solution = fit(session.with_y(y).without(rest), outliers.solution.theta)
        if solution is not None and not goodness(solution).too_large:
            return pair
    return None
