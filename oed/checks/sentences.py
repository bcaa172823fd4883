"""What a check found, in sentences that name file rows, columns, values and ranges."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from scipy import spatial

from oed import text
from oed.base import Array, Index
from oed.checks.copies import CoarseReadings, EqualReadings, coarse_columns
from oed.checks.explain import Explanation
from oed.checks.findings import MAX_LISTED_ROWS, CheckFinding, Severity, listing
from oed.checks.fit import Goodness
from oed.checks.outlier_odds import GROSS_ODDS, LOCATED_ODDS, FarReading, other_number
from oed.checks.outliers import OutlierSearch
from oed.checks.session import Ranges, SessionReadings
from oed.dataset import Row
from oed.fit_limits import GUESS_RATIO
from oed.result import GoodnessSection
from oed.text import capitalised, format_p_value

#: ratio of probabilities below which readings do not tell two mistakes apart
TIE_RATIO = 10.0
UNIT_FACTOR_TOLERANCE = 1.5  #: factor within which a misfit is such a factor


def explained(explanations: Sequence[Explanation]) -> list[CheckFinding]:
    """The mistake that explains the readings, and those that do as well."""
    if not explanations:
        return []
    best = explanations[0]
    alike = [
        k
        for k in explanations[1:MAX_LISTED_ROWS]
        if TIE_RATIO * k.probability > best.probability
    ]
    tie = "".join(f"; or {one.what} ({_percent(one)})" for one in alike)
    cannot = ". These readings cannot tell which" if alike else ""
    others = [k for k in explanations[1:MAX_LISTED_ROWS] if k not in alike]
    also = "; or ".join(f"{one.what} ({_percent(one)})" for one in others)
    also = f" Also possible: {also}." if also else ""
    sentence = (
        f"The readings look mistaken: {best.what} ({_percent(best)};"
        f" {misfits(best.before, best.after)}){tie}{cannot}.{also}"
    )
    return [CheckFinding(Severity.MISTAKE, best.kind, sentence)]


def misfits(before: float, after: float) -> str:
    """Misfit as given and with a mistake undone, over the stated noise."""
    as_given = "cannot be fitted as given"
    if np.isfinite(before):
        as_given = f"misfit as given: {_times(before)} the stated noise"
    undone = f"; with this undone: {_times(after)}" if np.isfinite(after) else ""
    return f"{as_given}{undone}"


def evidence(one: Explanation) -> str:
    """Probability of a mistake, and the misfit with and without it."""
    return f"{_percent(one)}; {misfits(one.before, one.after)}"


def _percent(one: Explanation) -> str:
    return f"probability {text.percent(one.probability)}"


def no_fit() -> CheckFinding:
    """Readings that no machine within its tolerances gives."""
    sentence = (
        "The readings cannot be fitted, and none of the usual mistakes explains them:"
        " check units, signs, order and set-up."
    )
    return CheckFinding(Severity.BAD_FIT, "fit", sentence)


def too_large(
    session: SessionReadings, fitted: Goodness, outliers: OutlierSearch
) -> CheckFinding:
    """Residuals that the stated noise does not explain."""
    sentence = f"The fit is bad: {_misfit(fitted, outliers)}."
    if outliers.unlocated:
        rows = session.rows(sorted(outliers.unlocated))
        sentence = f"{sentence} {_one_of(rows)}"
        return CheckFinding(Severity.BAD_FIT, "fit", sentence, rows)
    rows = session.rows(outliers.alike)
    many = ""
    if outliers.exhausted:
        many = "More rows deviate than can be single outliers. "
    elif rows:
        many = (
            f"{_count(rows)} are off the same way ({listing(rows)}): no single errors. "
        )
    cause = "the noise is understated, or an effect is not in the model"
    if fitted.ratio is not None and fitted.ratio > GUESS_RATIO:
        cause = (
            f"{_other_unit(fitted.ratio)}an effect of this size is not in the model, or"
            " the readings have a mistake that is not a usual one"
        )
    reason = f"None of the usual mistakes explains it: {cause}"
    if coarse_columns(session):
        reason = "Columns are rounded beyond the stated noise, which may be all of it"
    return CheckFinding(Severity.BAD_FIT, "fit", f"{sentence} {many}{reason}.")


def _other_unit(ratio: float) -> str:
    """That the noise may be stated in another unit, where the residuals look like it."""
    for factor in (1e3, 3600.0, 1e6):
        if factor / UNIT_FACTOR_TOLERANCE < ratio < factor * UNIT_FACTOR_TOLERANCE:
            return f"the noise may be stated in another unit ({factor:g} times it would fit); or "
    return ""


def _one_of(rows: Sequence[Row]) -> str:
    """That one of some rows is wrong, and what to do."""
    if len(rows) == 1:
        return (
            f"Without row {rows[0]} the others fit, but they do not prove that it is wrong:"
            " it is not set aside. Take this reading again, and more of them."
        )
    listed = ", ".join(map(str, rows))
    return (
        f"Without any one of the rows {listed} the others fit, and the readings cannot"
        f" tell which one is wrong (posterior odds below {LOCATED_ODDS:.0f}): none is set"
        " aside. Take these readings again, and more of them."
    )


def guessed(ratio: float, outliers: OutlierSearch) -> CheckFinding:
    """Residuals above a noise that was stated as a guess."""
    sentence = (
        f"The residuals are {_times(ratio)} the stated noise{_drop_words(outliers)}: the"
        " noise was understated, or an effect is not in the model. The standard"
        " deviations come from the residuals, as `estimate` in [noise] asks."
    )
    return CheckFinding(Severity.REMARK, "guess", sentence)


def explained_by_law(fitted: Goodness, outliers: OutlierSearch) -> CheckFinding:
    """Residuals above the stated noise that a noise law from the readings explains."""
    misfit = _misfit(fitted, outliers)
    sentence = (
        f"{capitalised(misfit)}: more than it explains. A larger or correlated noise explains"
        " them, and so would an effect or an unusual mistake: read some poses again on the"
        " spot. If these readings agree, it is no noise."
    )
    return CheckFinding(Severity.REMARK, "law", sentence)


def too_small(fitted: Goodness, outliers: OutlierSearch) -> CheckFinding:
    """Residuals below what the stated noise leaves."""
    sentence = (
        f"The residuals are only {_times(fitted.ratio or 0.0)} the stated noise"
        f"{_drop_words(outliers)} (chi2 {fitted.chi2:.4g} for {fitted.dof:.1f} degrees of"
        f" freedom, p {format_p_value(fitted.p_low)}): the noise is overstated or"
        " correlated along each run, or the readings were smoothed, averaged or computed."
    )
    return CheckFinding(Severity.REMARK, "too_small", sentence)


def _misfit(fitted: Goodness, outliers: OutlierSearch) -> str:
    """Residuals against the stated noise, where there is freedom to judge it."""
    p = format_p_value(fitted.p_high)
    if fitted.ratio is None:
        return (
            f"no machine within its tolerances gives these readings{_drop_words(outliers)}"
            f" (p {p}). They have no degree of freedom beyond the unknowns, and say"
            " nothing of the noise"
        )
    return (
        f"residuals are {_times(fitted.ratio)} the stated noise{_drop_words(outliers)}"
        f" (chi2 {fitted.chi2:.4g} for {fitted.dof:.1f} degrees of freedom, p {p})"
    )


def _drop_words(outliers: OutlierSearch) -> str:
    """Which rows a figure leaves out."""
    aside = GoodnessSection.without_rows(len(outliers.gross), "set aside")
    doubt = GoodnessSection.without_rows(len(outliers.doubtful), "in doubt")
    joint = " and" if aside and doubt else ""
    return f",{aside}{joint}{doubt}" if aside or doubt else ""


def computed(session: SessionReadings, readings: Index) -> CheckFinding:
    """Readings equal to those of the nominal machine."""
    rows = session.rows(readings)
    equal = "equals that" if len(rows) == 1 else "equal those"
    sentence = (
        f"{_count(rows)} {equal} of the nominal machine to within a small part of the"
        f" noise: computed, not measured? ({listing(rows)})"
    )
    return CheckFinding(Severity.BAD_FIT, "computed", sentence, rows)


def doubled(session: SessionReadings, groups: Sequence[EqualReadings]) -> CheckFinding:
    """Rows with readings equal to the last digit."""
    rows = tuple(k for one in groups for k in session.rows(one.readings))
    pairs = [
        " and ".join(str(k) for k in session.rows(one.readings)[:MAX_LISTED_ROWS])
        for one in groups[:MAX_LISTED_ROWS]
    ]
    more = ", ..." if len(groups) > MAX_LISTED_ROWS else ""
    poses = "at the same pose" if all(g.same_pose for g in groups) else "at other poses"
    sentence = (
        f"Readings are equal to the last digit {poses}, more often than chance allows:"
        f" rows {', '.join(pairs)}{more}. Rows doubled, or a frozen display?"
    )
    return CheckFinding(Severity.COPIES, "doubled", sentence, rows)


def interpolated(session: SessionReadings, readings: Index) -> CheckFinding:
    """Rows between their neighbours to the last digit."""
    rows = session.rows(readings)
    sentence = (
        f"{_count(rows)} {'lies' if len(rows) == 1 else 'lie'} half-way between the"
        f" neighbours to the last digit: interpolated, not measured? ({listing(rows)})"
    )
    return CheckFinding(Severity.COPIES, "interpolated", sentence, rows)


def coarse(session: SessionReadings, one: CoarseReadings) -> CheckFinding:
    """Readings rounded more coarsely than their noise."""
    column = session.column(one.channel)
    where = f" in run {one.run}" if one.run else ""
    sentence = (
        f"All readings of {column.name}{where} are multiples of"
        f" {one.step / column.factor:.6g}: rounding exceeds the stated noise."
    )
    rows = session.rows(one.readings) if one.run else ()
    return CheckFinding(Severity.REMARK, "coarse", sentence, rows)


def contradicting(pairs: "Sequence[Contradiction]") -> list[CheckFinding]:
    """Runs whose order of poses contradicts their column `direction`."""
    if not pairs:
        return []
    first = pairs[0]
    order, labels = ("same", "opposite") if first.same_order else ("opposite", "equal")
    more = f" (and {len(pairs) - 1} more pairs of runs)" if len(pairs) > 1 else ""
    sentence = (
        f"The runs {first.runs[0]} and {first.runs[1]} pass the same poses in the"
        f" {order} order, but have {labels} directions{more}: order or direction is wrong."
        " Play and friction are estimated by the order, which must be that of travel."
    )
    return [CheckFinding(Severity.REMARK, "direction", sentence, first.rows)]


def outliers(
    session: SessionReadings,
    found_rows: OutlierSearch,
    exchanged: tuple[int, int] | None,
) -> list[CheckFinding]:
    """Each outlier, and each reading that may be one, with row, column, value and what the
    others predict.
    """
    findings: list[CheckFinding] = []
    if exchanged is not None:
        rows = session.rows(exchanged)
        sentence = (
            f"Rows {rows[0]} and {rows[1]} look exchanged: each reading fits where the"
            " other one stands."
        )
        findings.append(CheckFinding(Severity.OUTLIER, "exchanged", sentence, rows))
    for one in found_rows.far:
        severity, kind = Severity.REMARK, "doubtful"
        verdict = (
            ". It may be a gross error or noise of heavy"
            f" tails (posterior odds below {GROSS_ODDS:.0f}): the row stays in the fit. Take"
            " this reading again."
        )
        if one in found_rows.gross:
            severity, kind = Severity.OUTLIER, "outlier"
            number = other_number(session, found_rows.solution, one)
            verdict = f": the row is set aside.{number}"
        sentence = f"{_contradiction(session, one)}{verdict}"
        row = session.rows([one.reading])
        findings.append(CheckFinding(severity, kind, sentence, row))
    return findings


def _contradiction(session: SessionReadings, one: FarReading) -> str:
    """How far a reading is from what all others predict."""
    channel = str(session.values["channel"].iloc[one.value])
    predicted = session.written(channel, session.y[one.value] - one.error)
    sd = session.fine(channel, abs(one.error / one.pull))
    return (
        f"{capitalised(_place(session, one.value))} is {abs(one.pull):.3g} sigma from the"
        f" {predicted} that all other readings predict for the pose of this row (sd {sd})"
    )


def outside(session: SessionReadings, ranges: Ranges, values: Index) -> CheckFinding:
    """Readings outside the range that tolerances and noise predict."""
    size = np.abs(session.y - ranges.middle) / ranges.sd
    ranked = values[np.argsort(-size[values], kind="stable")]
    first = int(ranked[0])
    channel = str(session.values["channel"].iloc[first])
    middle, half = ranges.middle[first], ranges.factor * ranges.sd[first]
    ends = float(middle - half), float(middle + half)
    lower, upper = (session.written(channel, end) for end in ends)
    rows = tuple(sorted({session.values["row"].iloc[k] for k in values}))
    lie = "lies" if len(rows) == 1 else "lie"
    sentence = (
        f"{_count(rows)} {lie} outside the range that tolerances and noise predict; the"
        f" farthest: {_place(session, first)}, predicted {lower} to {upper}"
        f" ({listing(rows)})."
    )
    return CheckFinding(Severity.REMARK, "outside", sentence, rows)


# -- words -----------------------------------------------------------------------------
def _place(session: SessionReadings, value: int) -> str:
    """`row 12, column length_mm = 300.1`."""
    channel, row = (session.values[c].iloc[value] for c in ("channel", "row"))
    written = session.written(str(channel), float(session.y[value]))
    return f"row {row}, column {session.column(str(channel)).name} = {written}"


def _count(rows: Sequence[Row]) -> str:
    return "1 reading" if len(rows) == 1 else f"{len(rows)} readings"


def _times(ratio: float) -> str:
    return f"{ratio:.3g} times" if ratio >= 100.0 else f"{ratio:.2g} times"


# Runs whose order of poses and whose column `direction` contradict each other.
#
# Two runs through the same poses in the same order have one sense of travel, in opposite
# orders two. Effects of the sense (play, friction) follow the order.


AGREEING_SHARE = 0.75  #: share of steps that must agree
JOINT_TOLERANCE = 1e-6  #: joints are equal to so much of their largest difference


@dataclasses.dataclass(frozen=True)
class Contradiction:
    """Two runs through the same poses; rows are those that open each run."""

    runs: tuple[str, str]
    rows: tuple[Row, Row]
    same_order: bool  #: whether they pass the poses in the same order


def contradictions(session: SessionReadings) -> list[Contradiction]:
    """Pairs of runs of one direction each whose orders and directions do not go together."""
    if "direction" not in session.values.columns:
        return []
    runs = []
    for setup, run, frame in session.ordered_runs():
        directions = np.unique(frame["direction"].to_numpy(dtype=float))
        if len(directions) == 1 and abs(directions[0]) == 1.0:
            path = session.joints[frame["reading"].to_numpy()]
            runs.append((setup, run, frame["row"].iloc[0], directions[0], path))
    pairs = []
    for one, other in itertools.combinations(runs, 2):
        setups, names, rows, signs, paths = zip(one, other, strict=True)
        sense = _relative_sense(*paths) if setups[0] == setups[1] else 0.0
        if sense * signs[0] * signs[1] < 0.0:
            pairs.append(Contradiction(names, rows, sense > 0.0))
    return pairs


def _relative_sense(one: Array, other: Array) -> float:
    """+1 or -1 by the order in which two paths pass common poses; 0 if unknown."""
    size = max(float(np.ptp(one, axis=0).max()), 1e-12)
    near = _pairs_within(one, other, JOINT_TOLERANCE * size)
    count_one = np.bincount(near[:, 0], minlength=len(one))
    count_other = np.bincount(near[:, 1], minlength=len(other))
    unique = (count_one[near[:, 0]] == 1) & (count_other[near[:, 1]] == 1)
    poses = near[unique]
    if len(poses) < 4:
        return 0.0
    rank = np.argsort(np.argsort(poses[:, 1]))
    steps = np.diff(rank) % len(rank)
    forward = float(np.mean(steps == 1))
    backward = float(np.mean(steps == len(rank) - 1))
    if forward >= AGREEING_SHARE:
        return 1.0
    return -1.0 if backward >= AGREEING_SHARE else 0.0


def _pairs_within(one: Array, other: Array, size: float) -> Index:
    """Pairs (p, 2) of places (n, k) and (m, k) less than a size apart, in order."""
    tree = spatial.cKDTree(other)
    near = tree.query_ball_point(one, size, p=np.inf, return_sorted=True)
    first = np.repeat(np.arange(len(one)), [len(places) for places in near])
    pairs = np.column_stack([first, np.array([k for n in near for k in n], dtype=int)])
    apart = np.abs(one[pairs[:, 0]] - other[pairs[:, 1]]).max(axis=1, initial=0.0)
    return np.asarray(pairs[apart < size], dtype=np.intp)
