"""What a study ends in: `result.json`, loss-free, so that a report can be made again
from it.

Field names are fixed by the contract; values are SI unless a `unit` stands beside them.
Arrays are lists.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from oed.result.corrected import CorrectedSection
from oed.result.fit import EstimateSection, GoodnessSection, PosteriorSection, RunCurve
from oed.result.gap import GapBeforeSection, GapSection, MixtureSection
from oed.result.plan import DesignSection, IdentifiabilitySection, KappaMap, PlanSection
from oed.result.prediction import (
    AcceptanceSection,
    AdjustmentSection,
    ForecastSection,
    HeldOutSection,
    PredictionSection,
    VerificationSection,
    WantedVerdict,
)
from oed.result.record import Point, Record


class Claim(Record, frozen=True):
    """A claim of the study's [expect] table, measured, in `unit` where it has one."""

    claim: str
    measured: float | str
    wanted: str
    met: bool
    unit: str = ""

    def failure(self, where: str) -> str:
        """What it says where it is not met: measured against claimed, and where it stands."""
        measured = self.measured
        if isinstance(measured, float):
            measured = f"{measured:.6g}"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.claim}: measured {measured}{unit}, claimed {self.wanted}{unit} ({where})"


class Polyline(Record, frozen=True):
    """A polyline of the drawing, m."""

    kind: str  # machine | path | reading | cup
    points: list[Point]


class DrawingLabel(Record, frozen=True):
    """Parameters at the point of the drawing (3,), m, that they move.

    text    the names, shortened: `da1x, y, z`
    """

    at: Point
    text: str
    parameters: list[str]


class Drawing(Record, frozen=True):
    """The machine at its home pose and the planned tool points, m, base frame.

    bars             of each tool point, empty without a far end; none where no reading
                     has one
    runs, commands   of each tool point; commands in user units, empty where only joints
                     are known
    labels           where the machine's parameters act
    """

    lines: list[Polyline]
    tool_points: list[Point]
    reading_of: list[str]  # set-up of each tool point
    bars: list[
        Annotated[list[Point], msgspec.Meta(max_length=2)]
    ]  # reading's far end to tool point, where there is one
    runs: list[str] = []
    commands: list[dict[str, float]] = []
    labels: list[DrawingLabel] = []


class MachineInfo(Record, frozen=True):
    """The machine's table, in display units.

    parameters  rows of name, about, unit, nominal, tolerance; `held` where the
                controller holds other values, `expected` where the prior mean is another
    controller  what the study names as held by the controller; "" for nominal numbers
    earlier     session whose posterior is the prior; "" for tolerances
    fleet       results of other machines whose mean and spread are the prior
    """

    name: str
    about: str
    source: str
    parameters: list[dict[str, str | float]]
    frame: list[str]
    controller: str = ""
    earlier: str = ""
    fleet: list[str] = []


class SetupInfo(Record, frozen=True):
    """A set-up as used, in display units."""

    name: str
    instrument: str
    about: str
    numbers: dict[str, float]
    sigma: dict[str, float]
    unknowns: dict[str, float]


class StudyResult(Record, frozen=True, kw_only=True):
    """The whole result of one study; sections of stages that did not run are null.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> result = oed.run(study, "out/planar")
    >>> sorted(result.estimate.parameters)[:3]
    ['D', 'beta1', 'beta2']
    """

    SCHEMA: ClassVar[int] = 1

    schema: int
    version: str
    study: str
    title: str = ""
    question: str = ""
    seed: int
    seconds: (
        float  # wall time; the only entry that differs between two runs with one seed
    )
    machine: MachineInfo
    setups: list[SetupInfo] = []
    study_text: str = ""
    #: digests of the fitted readings and of those behind the prior, sorted
    readings: list[str] = []
    versions: dict[str, str] = {}
    headline: list[str] = []  # the five numbers that matter, as sentences
    identifiability: IdentifiabilitySection | None = None
    identifiability_of: dict[
        str, IdentifiabilitySection
    ] = {}  # variants asked for: one circle, one tool, ...
    design: DesignSection | None = None
    kappa_maps: list[KappaMap] = []
    plan: PlanSection | None = None
    goodness: GoodnessSection | None = None
    estimate: EstimateSection | None = None
    posterior: PosteriorSection | None = None
    prediction: PredictionSection | None = None
    #: on each wanted accuracy, by component
    verdicts: dict[str, WantedVerdict] = {}
    held_out: list[HeldOutSection] = []
    gap: GapSection | None = None
    corrected: CorrectedSection | None = None
    acceptance: AcceptanceSection | None = None
    verification: VerificationSection | None = None
    adjustment: AdjustmentSection | None = None
    #: circles and lines that the compensated machine was read along
    after_compensation: list[RunCurve] = []
    gap_before: GapBeforeSection | None = None
    forecast: ForecastSection | None = None
    drawing: Drawing | None = None
    warnings: list[str] = []
    written: dict[str, str] = {}  # SHA-256 of the files to fill in or to copy from
    claims: list[Claim] = []

    @property
    def controller_mixture(self) -> MixtureSection | None:
        """Parameters over all hypotheses of a diagnosis that a controller can be given."""
        mixture = None if self.gap is None else self.gap.mixture
        return mixture if mixture is not None and mixture.controller else None

    @property
    def corrects_effects(self) -> bool:
        """Whether the best answer's effects are corrected as well: not if that is worse."""
        mixture = self.controller_mixture
        is_better = mixture is None or mixture.with_effects is not None
        return self.corrected is not None and is_better

    @property
    def final_estimate(self) -> EstimateSection | CorrectedSection | None:
        """The corrected estimate where there is one, which effects do not bend."""
        return self.corrected or self.estimate

    @property
    def final_prediction(self) -> PredictionSection | None:
        """The predicted accuracy with that estimate."""
        return self.prediction if self.corrected is None else self.corrected.prediction

    @property
    def judged_prediction(self) -> PredictionSection | None:
        """The predicted accuracy that is judged: over all hypotheses where there are any."""
        mixture = None if self.gap is None else self.gap.mixture
        if mixture is not None and mixture.prediction is not None:
            return mixture.with_effects or mixture.prediction
        return self.final_prediction
