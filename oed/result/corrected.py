"""Parameters and effects estimated together: the `corrected` section of result.json."""

from __future__ import annotations

from oed.result.fit import Marginal, ParameterEstimate
from oed.result.prediction import PredictionSection, SpreadRecord
from oed.result.record import Record


class EffectEstimate(Record, frozen=True):
    """A coefficient of an effect, in `unit`; `prior_sd` is the size expected of it.

    shape    whether it only lets the form depart from the textbook's
    """

    value: float
    sd: float
    unit: str
    effect: str
    prior_sd: float
    shape: bool = False


class EffectTable(Record, frozen=True):
    """Joint corrections of an effect over a state, for a controller to add.

    state          `pose`, `direction`, `payload_N` or `temp_<body>_C`, a rise above the
                   session's start
    joint_wise     whether each joint's correction is read at that joint's own state
    values         of the state; between them corrections go in straight lines
    joints         names of the joints with their unit
    commands       at which the corrections hold: a grid with equal steps
    table          [value][command][joint]
    interpolation  {component: rms error, in its fine unit} that straight lines between
                   the commands leave, in the worst state
    """

    effect: str
    state: str
    joint_wise: bool
    values: list[float]
    joints: list[str]
    commands: list[dict[str, float]]
    table: list[list[list[float]]]
    interpolation: dict[str, float] = {}


class CorrectedSection(Record, frozen=True):
    """What a compensation takes: estimates that the effects do not bend.

    parameters       {name: estimate}, those of the set-ups included
    effects          {`effect: coefficient`: estimate}
    constants        {effect: {constant: value}}, SI, of the form that fits best
    conditions       what the corrected machine's accuracy rests on, in sentences
    origin           `diagnosis`, or `given` where effects were named
    rms_after        {channel: rms residual, in its fine unit}
    chi2, dof        against the stated noise
    covariance       of `parameters`, in their units
    prediction       with parameters and effects compensated; null without a workspace
    parameters_only  {component: accuracy with the effects left uncompensated}
    controller       parameters for a controller that corrects geometry alone, in the
                     units of `parameters`; empty: the parameters themselves
    sent             the compensation of least expected error, as in `gap.mixture.choices`
    posterior        {name: marginal}, where the study samples
    tables           joint corrections of the effects by state, which add up
    not_tabled       {effect: why no table holds it}
    warnings         sentences that a user must know
    """

    parameters: dict[str, ParameterEstimate]
    effects: dict[str, EffectEstimate]
    constants: dict[str, dict[str, float]]
    conditions: list[str]
    origin: str
    rms_after: dict[str, float]
    units: dict[str, str]
    readings: int
    chi2: float
    dof: float
    covariance: list[list[float]]
    prediction: PredictionSection | None = None
    parameters_only: dict[str, SpreadRecord] = {}
    controller: dict[str, float] = {}
    sent: str = ""
    posterior: dict[str, Marginal] = {}
    tables: list[EffectTable] = []
    not_tabled: dict[str, str] = {}
    warnings: list[str] = []
