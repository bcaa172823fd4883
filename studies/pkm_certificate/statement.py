"""What a calibration certificate states: written as XML and as PDF, not into result.json."""

from typing import Annotated, Literal

import msgspec

from oed.result import Judgement, Record
from oed.verdict import judge
from pkm_studies.tables import Positive, StudyTable

#: two letters of ISO 3166-1; empty where a user has not stated it yet
Country = Annotated[str, msgspec.Meta(pattern="^([A-Z][A-Z])?$")]
#: deg C at a machine: what is beyond was read in another unit
Temperature = Annotated[float, msgspec.Meta(gt=-100, lt=200)]
#: probability from which a conformity is stated
Rule = Annotated[float, msgspec.Meta(gt=0.5, lt=1)]


class CertifiedParameter(Record, frozen=True):
    """An identified parameter of the machine, SI."""

    name: str
    about: str
    value: float
    sd: float
    unit: str
    source: str  #: where the value comes from, in words


class CertifiedAccuracy(Record, frozen=True):
    """Errors of one pose component after compensation, SI."""

    component: str
    rms: float
    max: float
    unit: str
    p95: float | None = None
    #: 95 % of the machines have an rms error between its ends
    interval: tuple[float, float] | None = None
    limit: float | None = None
    verdict: Judgement | None = None  #: of the acceptance test; None for a prediction


class Conformity(Record, frozen=True):
    """Probability that a true value lies within its tolerance (JCGM 106), SI."""

    quantity: str  #: what the tolerance is of
    basis: str  #: what the probability rests on
    tolerance: float  #: largest rms error, or largest departure from nominal
    unit: str
    probability: float
    #: whether conformity can be stated: a prediction that no reading beyond the fit
    #: confirms is certified as such, with its probability
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


class Laboratory(Institution, frozen=True, kw_only=True):
    """Who calibrated; `accreditation` is its registration, where there is one."""

    accreditation: str = ""


class CertificateHead(StudyTable, frozen=True, kw_only=True):
    """certificate.toml: what no calibration can know, as the user states it.

    Dates are ISO 8601, the temperature during the readings is in degrees Celsius.
    """

    identifier: str
    country: Country
    begin: str
    end: str
    place: Literal[
        "laboratory", "customer", "laboratoryBranch", "customerBranch", "other"
    ]
    issued: str = ""
    temperature: Temperature | None = msgspec.field(default=None, name="temperature_C")
    decision: Rule | None = None
    item: CertifiedItem
    laboratory: Laboratory
    customer: Institution
    person: list[Person]
    instrument: list[UsedInstrument] = msgspec.field(default_factory=list)
    tolerance: dict[str, Positive] = msgspec.field(default_factory=dict)


class Certificate(Record, frozen=True, kw_only=True):
    """All that a certificate states."""

    head: CertificateHead
    study: str
    version: str
    machine: str
    about: str
    setups: list[str]
    parameters: list[CertifiedParameter]
    covariance: list[list[float]]  #: of the parameters, SI
    readings: int
    poses: int
    reference: str  #: against which errors are stated: absolute, home or best_fit
    predicted: list[CertifiedAccuracy]
    verified_poses: int = 0
    verified: list[CertifiedAccuracy] = []
    conformity: list[Conformity] = []
    conditions: list[str] = []  #: sentences on what the figures rest on

    @property
    def verdicts(self) -> list[Judgement | None]:
        """The verdict on each conformity; None where no decision rule is stated."""
        rule = self.head.decision
        if rule is None:
            return [None] * len(self.conformity)
        return [
            judge(c.probability, rule, can_pass=c.can_pass) for c in self.conformity
        ]
