"""Checks of the readings, and their noise: the `goodness` section of result.json."""

from __future__ import annotations

from oed.result.record import Number, Record


class OutlierRecord(Record, frozen=True):
    """A reading that all others contradict.

    row   of its file
    file  its name, where the readings are of several
    """

    setup: str
    run: str
    order: int
    row: int
    pull: float
    file: str = ""


class MistakeRecord(Record, frozen=True):
    """A mistake that explains readings which do not fit, and how far it does."""

    what: str
    evidence: str


class NoiseRecord(Record, frozen=True):
    """One number of the noise law as estimated.

    kind     reading (about the mean of its run), run, seat, course at the session's end
             (standard deviations),
             carried (share of the variance) or reach (in readings)
    of       set-up and channel, or set-up; empty for all readings
    stated   what the stated noise has
    departs  whether it surely differs from that by more than matters
    """

    kind: str
    of: str
    value: float
    sd: float
    unit: str
    stated: Number = None
    departs: bool = False


class LeftOutRun(Record, frozen=True):
    """A run against what all other runs predict of it.

    values     number of its values
    ratio      its errors over what is predicted
    p_high     probability of larger errors
    log_score  log predictive density, readings in units of their noise
    """

    setup: str
    run: str
    values: int
    ratio: float
    p_high: float
    log_score: float

    @property
    def chi2(self) -> float:
        """Squared standardised errors, of as many degrees of freedom as values."""
        return self.ratio**2 * self.values


class GoodnessSection(Record, frozen=True):
    """Goodness of fit against the stated noise, and what a check of the readings says.

    chi2, dof  of the parameters that are delivered, as in `estimate`, without `outliers`
               and `doubtful`; p_low, p_high  probabilities of less and of more
    law_p_low, law_p_high  of less and of more under the law that is estimated, with a
               scatter of single readings within what a statement is good for
    bad_fit    whether nothing fitted to the readings can be trusted
    outliers   gross errors, which no fit includes
    doubtful   readings that may be gross errors or noise; fits include them
    unlocated  rows of the file one of which is wrong; fits include all
    findings   sentences, the most harmful first
    noise     the noise law as estimated, by the names of its numbers; empty where the
              noise is as stated
    noise_words  how it departs from the stated noise, as sentences
    left_out  each run predicted from the others; their log score with its standard
              deviation in `left_out_score` and `left_out_sd`
    """

    chi2: Number
    dof: Number
    p_low: Number
    p_high: Number
    bad_fit: bool = False
    outliers: list[OutlierRecord] = []
    doubtful: list[OutlierRecord] = []
    unlocated: list[int] = []
    mistakes: list[MistakeRecord] = []
    findings: list[str] = []
    noise: dict[str, NoiseRecord] = {}
    noise_words: list[str] = []
    left_out: list[LeftOutRun] = []
    left_out_score: Number = None
    left_out_sd: Number = None
    law_p_low: Number = None
    law_p_high: Number = None

    @property
    def fit_words(self) -> str:
        """What the figures of a fit leave out, as the end of a phrase: rows set aside."""
        return without_rows(len(self.outliers), "set aside")

    @property
    def chi2_words(self) -> str:
        """What chi2 leaves out, likewise: rows set aside, and rows in doubt."""
        doubtful = without_rows(len(self.doubtful), "in doubt")
        joint = " and" if self.outliers and doubtful else ""
        return f"{self.fit_words}{joint}{doubtful}"


def without_rows(count: int, what: str) -> str:
    """` without the 2 rows set aside`; empty for none."""
    return f" without the {count} row{'s' if count > 1 else ''} {what}" if count else ""
