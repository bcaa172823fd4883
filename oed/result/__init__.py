"""The records of result.json: what studies write and reports read.

Field names are fixed by the contract; values are SI unless a `unit` stands beside them.
Other rooms take records from here: as many as the file has.
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.result.agreement import breaches
    from oed.result.closure import ClosestClosure, MachineShape
    from oed.result.corrected import CorrectedSection, EffectEstimate, EffectTable
    from oed.result.fit import (
        CombinationEstimate,
        EstimateSection,
        GoodnessSection,
        HeldParameter,
        LeftOutRun,
        Marginal,
        MistakeRecord,
        NoiseRecord,
        OutlierRecord,
        ParameterEstimate,
        PosteriorSection,
        PredictiveCheckRecord,
        RunCurve,
    )
    from oed.result.gap import (
        UNKNOWN,
        AnswerRecord,
        ChosenRun,
        ChosenRuns,
        ClosureRecord,
        CoefficientRecord,
        CompensationChoice,
        CompensationName,
        DetectabilityRecord,
        DetectabilityTable,
        EffectNote,
        GapBeforeSection,
        GapSection,
        MixedAnswer,
        MixedParameter,
        MixtureSection,
        PlaceRecord,
        RivalRecord,
        SecondVisitRecord,
        SeparationRecord,
        SharedRecord,
        SizeRecord,
        Spot,
        Trace,
        probability_of,
    )
    from oed.result.plan import (
        AllowedEffects,
        AlternativePlan,
        CandidateWeight,
        CriterionComparison,
        DesignSection,
        HowManySummary,
        IdentifiabilityFinding,
        IdentifiabilitySection,
        KappaMap,
        PlanEffects,
        PlannedReading,
        PlanScore,
        PlanSection,
        PolishSummary,
        RecordedChoice,
        RecordingSection,
        RelaxedSummary,
        RobustSummary,
        Sd,
        SequenceRecord,
        StageRecord,
        WorkingOrder,
    )
    from oed.result.prediction import (
        AcceptanceSection,
        AdjustedRecord,
        AdjustmentLine,
        AdjustmentSection,
        BudgetLine,
        BudgetSection,
        ComponentAccuracy,
        ForecastComponent,
        ForecastSection,
        HeldOutSection,
        HeldOutVerdict,
        MapPoint,
        PositioningRecord,
        PredictionSection,
        PromiseRecord,
        SpreadRecord,
        ToolAccuracy,
        UnmodelledLine,
        UsualEffects,
        VerdictRecord,
        VerificationSection,
        WantedVerdict,
    )
    from oed.result.record import Judgement, Record, finite_or_none
    from oed.result.study import (
        Claim,
        Drawing,
        DrawingLabel,
        MachineInfo,
        Polyline,
        SetupInfo,
        StudyResult,
    )
else:
    # imported when first used: a room takes few of them
    __getattr__ = door(__name__)
