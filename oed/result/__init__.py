"""The types of result.json: what studies write and reports read.

Field names are fixed by the contract; values are SI unless a `unit` stands beside them.
"""

from oed.result.acceptance import (
    AcceptanceSection,
    PositioningRecord,
    PromiseRecord,
    VerdictRecord,
    VerificationSection,
)
from oed.result.corrected import CorrectedSection, EffectEstimate
from oed.result.design import (
    CriterionComparison,
    DesignSection,
    HowManySummary,
    PlannedReading,
    PlanScore,
    PolishSummary,
    RobustSummary,
    WorkingOrder,
)
from oed.result.fit import (
    EstimateSection,
    Marginal,
    ParameterEstimate,
    PosteriorSection,
)
from oed.result.gap import (
    AnswerRecord,
    ClosureRecord,
    CoefficientRecord,
    EffectNote,
    GapSection,
    PlaceRecord,
    SizeRecord,
    Spot,
    Trace,
)
from oed.result.gap_before import (
    ChosenRun,
    ChosenRuns,
    DetectabilityRecord,
    DetectabilityTable,
    GapBeforeSection,
    RivalRecord,
    SeparationRecord,
    SharedRecord,
)
from oed.result.goodness import (
    GoodnessSection,
    MistakeRecord,
    NoiseRecord,
    OutlierRecord,
)
from oed.result.identifiability import (
    IdentifiabilityFinding,
    IdentifiabilitySection,
    KappaMap,
)
from oed.result.plan import (
    AlternativePlan,
    PlanSection,
    Sd,
    SequenceRecord,
    StageRecord,
)
from oed.result.prediction import (
    ComponentAccuracy,
    HeldOutSection,
    MapPoint,
    PredictionSection,
    SpreadRecord,
)
from oed.result.record import Record
from oed.result.study import (
    SCHEMA,
    Claim,
    Drawing,
    DrawingLabel,
    MachineInfo,
    Polyline,
    SetupInfo,
    StudyResult,
)

__all__ = [
    "SCHEMA",
    "AcceptanceSection",
    "AlternativePlan",
    "AnswerRecord",
    "ChosenRun",
    "ChosenRuns",
    "Claim",
    "ClosureRecord",
    "CoefficientRecord",
    "ComponentAccuracy",
    "CorrectedSection",
    "CriterionComparison",
    "DesignSection",
    "DetectabilityRecord",
    "DetectabilityTable",
    "Drawing",
    "DrawingLabel",
    "EffectEstimate",
    "EffectNote",
    "EstimateSection",
    "GapBeforeSection",
    "GapSection",
    "GoodnessSection",
    "HeldOutSection",
    "HowManySummary",
    "IdentifiabilityFinding",
    "IdentifiabilitySection",
    "KappaMap",
    "MachineInfo",
    "MapPoint",
    "Marginal",
    "MistakeRecord",
    "NoiseRecord",
    "OutlierRecord",
    "ParameterEstimate",
    "PlaceRecord",
    "PlanScore",
    "PlanSection",
    "PlannedReading",
    "PolishSummary",
    "Polyline",
    "PositioningRecord",
    "PosteriorSection",
    "PredictionSection",
    "PromiseRecord",
    "Record",
    "RivalRecord",
    "RobustSummary",
    "Sd",
    "SeparationRecord",
    "SequenceRecord",
    "SetupInfo",
    "SharedRecord",
    "SizeRecord",
    "Spot",
    "SpreadRecord",
    "StageRecord",
    "StudyResult",
    "Trace",
    "VerdictRecord",
    "VerificationSection",
    "WorkingOrder",
]
