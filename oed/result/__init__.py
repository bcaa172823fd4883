"""The records of result.json: what studies write and reports read.

Field names are fixed by the contract; values are SI unless a `unit` stands beside them.
Other rooms take records from here: as many as the file has.
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.result.acceptance import (
        AcceptanceSection,
        PositioningRecord,
        PromiseRecord,
        VerdictRecord,
        VerificationSection,
    )
    from oed.result.adjustment import AdjustedRecord, AdjustmentLine, AdjustmentSection
    from oed.result.agreement import breaches
    from oed.result.budget import (
        BudgetLine,
        BudgetSection,
        UnmodelledLine,
        UsualEffects,
    )
    from oed.result.closest_closure import ClosestClosure, MachineShape
    from oed.result.corrected import CorrectedSection, EffectEstimate, EffectTable
    from oed.result.design import (
        AllowedEffects,
        CandidateWeight,
        CriterionComparison,
        DesignSection,
        HowManySummary,
        PlannedReading,
        PlanScore,
        PolishSummary,
        RelaxedSummary,
        RobustSummary,
        WorkingOrder,
    )
    from oed.result.fit import (
        EMCEE,
        IMPORTANCE,
        CombinationEstimate,
        EstimateSection,
        HeldParameter,
        Marginal,
        ParameterEstimate,
        PosteriorSection,
        PredictiveCheckRecord,
        RunCurve,
        largest_pareto_k,
    )
    from oed.result.forecast import ForecastComponent, ForecastSection
    from oed.result.gap import (
        EVEN,
        LEAST_CLOSURE,
        MISSED_GAP_COST,
        NO_GAP_PROBABILITY,
        AnswerRecord,
        ClosureRecord,
        CoefficientRecord,
        EffectNote,
        GapSection,
        PlaceRecord,
        SecondVisitRecord,
        SizeRecord,
        Spot,
        Trace,
        visible_probability,
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
        LeftOutRun,
        MistakeRecord,
        NoiseRecord,
        OutlierRecord,
        without_rows,
    )
    from oed.result.identifiability import (
        IdentifiabilityFinding,
        IdentifiabilitySection,
        KappaMap,
    )
    from oed.result.mixture import (
        BEST,
        BEST_WITH_EFFECTS,
        MIXTURE,
        NOTHING,
        PLAIN,
        CompensationChoice,
        MixedAnswer,
        MixedParameter,
        MixtureSection,
    )
    from oed.result.plan import (
        AlternativePlan,
        PlanEffects,
        PlanSection,
        Sd,
        SequenceRecord,
        StageRecord,
    )
    from oed.result.prediction import (
        LEVELS,
        ComponentAccuracy,
        HeldOutSection,
        HeldOutVerdict,
        MapPoint,
        PredictionSection,
        SpreadRecord,
        ToolAccuracy,
        WantedVerdict,
    )
    from oed.result.record import Judgement, Number, Record, finite_or_none
    from oed.result.recording import RecordedChoice, RecordingSection
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
else:
    # imported when first used: a room takes few of them
    __getattr__ = door(__name__)
