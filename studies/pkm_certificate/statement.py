"""What a calibration certificate states: written as XML and as PDF, not into result.json."""

from typing import Annotated

import msgspec

from oed.result import Judgement, Record
from oed.verdict import judge

#: two letters of ISO 3166-1; empty where a user has not stated it yet
Country = Annotated[str, msgspec.Meta(pattern="^([A-Z][A-Z])?$")]


class CertifiedParameter(Record, frozen=True):
    """An identified parameter of the machine, SI.

    source  where the value comes from, in words
    """

    name: str
    about: str
    value: float
    sd: float
    unit: str
    source: str


class CertifiedAccuracy(Record, frozen=True):
    """Errors of one pose component after compensation, SI.

    verdict   of the acceptance test; None for a prediction
    interval  95 % of the machines have an rms error between its ends
    """

    component: str
    rms: float
    max: float
    unit: str
    p95: float | None = None
    interval: tuple[float, float] | None = None
    limit: float | None = None
    verdict: Judgement | None = None


class Conformity(Record, frozen=True):
    """Probability that a true value lies within its tolerance (JCGM 106), SI.

    quantity   what the tolerance is of
    basis      what the probability rests on
    tolerance  largest rms error, or largest departure from nominal
    can_pass   whether conformity can be stated: a prediction that no reading beyond the
               fit confirms is certified as such, with its probability
    """

    quantity: str
    basis: str
    tolerance: float
    unit: str
    probability: float
    can_pass: bool = True


class Institution(Record, frozen=True):
    """An institution, or a customer; empty texts are not stated."""

    name: str
    city: str
    country: Country
    street: str = ""
    post_code: str = ""
    email: str = ""


class Person(Record, frozen=True):
    """Who answers for the certificate."""

    name: str
    role: str = ""
    signs: bool = False


class CertifiedItem(Record, frozen=True):
    """The machine: what identifies it."""

    serial: str
    manufacturer: str = ""
    model: str = ""


class UsedInstrument(Record, frozen=True):
    """An instrument of the calibration."""

    name: str
    serial: str = ""
    certificate: str = ""


class CertificateHead(Record, frozen=True, kw_only=True):
    """What no calibration can know: as the user states it. Dates are ISO 8601, the
    temperature during the readings is in degrees Celsius."""

    identifier: str
    country: str
    begin: str
    end: str
    place: str
    issued: str = ""
    temperature: float | None = None
    decision: float | None = None
    item: CertifiedItem
    laboratory: Institution
    accreditation: str = ""
    customer: Institution
    persons: list[Person]
    instruments: list[UsedInstrument] = []


class Certificate(Record, frozen=True, kw_only=True):
    """All that a certificate states.

    covariance  of the parameters, SI
    reference   against which errors are stated: absolute, home or best_fit
    conditions  sentences on what the figures rest on
    """

    head: CertificateHead
    study: str
    version: str
    machine: str
    about: str
    setups: list[str]
    parameters: list[CertifiedParameter]
    covariance: list[list[float]]
    readings: int
    poses: int
    reference: str
    predicted: list[CertifiedAccuracy]
    verified_poses: int = 0
    verified: list[CertifiedAccuracy] = []
    conformity: list[Conformity] = []
    conditions: list[str] = []

    @property
    def verdicts(self) -> list[Judgement | None]:
        """The verdict on each conformity; None where no decision rule is stated."""
        rule = self.head.decision
        if rule is None:
            return [None] * len(self.conformity)
        return [
            judge(c.probability, rule, can_pass=c.can_pass) for c in self.conformity
        ]
