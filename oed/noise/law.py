"""The noise law of a diagnosis: one of some laws, at a level, with its tails."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Index
from oed.noise.factor import Errors, LinearFactor
from oed.noise.law_noise import errors_in_units
from oed.noise.process import Laws
from oed.noise.structure import ReadingStructure

#: share of the stated noise from which a part of a law is described
WORTH_SAYING = 0.2
#: share of the longest run beyond which its readings do not show where an error ends
SHOWN_REACH = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class NoiseLaw:
    """A noise law, in units of the stated noise.

    law            one of some laws
    level          factor on everything; 1 where it is marginalised elsewhere
    student_dof    degrees of freedom of the readings' Student t, inf where they are
                   normal
    outlier_share  share of readings that are far off, where the others are normal
    """

    law: Laws
    level: float = 1.0
    student_dof: float = np.inf
    outlier_share: float = 0.0

    def errors(self, structure: ReadingStructure, rows: Index | None = None) -> Errors:
        """What the covariance of the readings, or of `rows`, consists of."""
        errors = errors_in_units(structure, self.law, rows)
        return dataclasses.replace(errors, scale=self.level * errors.scale)

    def factor(
        self, structure: ReadingStructure, rows: Index | None = None
    ) -> LinearFactor:
        """Root of the covariance of all readings, or of the readings `rows`."""
        return LinearFactor(self.errors(structure, rows))


def reach_words(reach: float, longest: float) -> str:
    """How far an error is carried along a run, as far as its readings can show it.

    reach, longest  in readings; of the error, and of the longest run
    """
    if reach > SHOWN_REACH * longest:
        return f"over whole runs of up to {longest:.0f} readings"
    if reach < 1.5:
        return "to the next reading"
    return f"over about {reach:.0f} readings"


def describe(law: NoiseLaw, longest: float = np.inf) -> tuple[str, ...]:
    """A law as a person reads it.

    longest  number of readings of the longest run
    """
    sentences = [f"single readings scatter by {law.level:.2g} times the stated noise"]
    run, seat = (float(sizes[0]) for sizes in (law.law.level, law.law.seat))
    carried, reach = float(np.sqrt(law.law.carried[0])), float(law.law.reach[0])
    if run > WORTH_SAYING:
        sentences.append(
            f"a run repeats to {law.level * run:.2g} times the stated noise"
        )
    if seat > WORTH_SAYING:
        sentences.append(
            "what a run seats anew, such as a cup on its magnet, repeats to"
            f" {law.level * seat:.2g} times the stated noise"
        )
    if carried > WORTH_SAYING:
        sentences.append(
            f"an error of {law.level * carried:.2g} times the stated noise is"
            f" carried along {reach_words(reach, longest)}"
        )
    if np.isfinite(law.student_dof):
        sentences.append(
            f"readings far off are frequent (Student t with {law.student_dof:.2g}"
            " degrees of freedom)"
        )
    if law.outlier_share > 0.0:
        sentences.append(
            f"about {100.0 * law.outlier_share:.2g} % of the readings are far off"
        )
    return tuple(sentences)
