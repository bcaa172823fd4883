"""Parameters and effects estimated together: the `corrected` section of result.json."""

from oed.result.fit import Marginal, ParameterEstimate
from oed.result.prediction import PredictionSection, SpreadRecord
from oed.result.record import Record


class EffectEstimate(Record, frozen=True):
    """A coefficient of an effect, in `unit`; `prior_sd` is the size expected of it."""

    value: float
    sd: float
    unit: str
    effect: str
    prior_sd: float
    shape: bool = False  #: whether it only lets the form depart from the textbook's


class EffectTable(Record, frozen=True):
    """Joint corrections of an effect over a state, for a controller to add."""

    effect: str
    #: `pose`, `direction`, `payload_N` or `temp_<body>_C`, a rise above the session's
    #: start
    state: str
    #: whether each joint's correction is read at that joint's own state
    joint_wise: bool
    values: list[float]  #: of the state; between them corrections go in straight lines
    joints: list[str]  #: names of the joints with their unit
    #: at which the corrections hold: a grid with equal steps
    commands: list[dict[str, float]]
    table: list[list[list[float]]]  #: [value][command][joint]
    #: {component: rms error, in its fine unit} that straight lines between the commands
    #: leave, in the worst state
    interpolation: dict[str, float] = {}


class CorrectedSection(Record, frozen=True):
    """What a compensation takes: estimates that the effects do not bend."""

    #: {name: estimate}, those of the set-ups included
    parameters: dict[str, ParameterEstimate]
    effects: dict[str, EffectEstimate]  #: {`effect: coefficient`: estimate}
    #: {effect: {constant: value}}, SI, of the form that fits best
    constants: dict[str, dict[str, float]]
    #: what the corrected machine's accuracy rests on, in sentences
    conditions: list[str]
    origin: str  #: `diagnosis`, or `given` where effects were named
    rms_after: dict[str, float]  #: {channel: rms residual, in its fine unit}
    units: dict[str, str]
    readings: int
    #: against the stated noise
    chi2: float
    dof: float
    covariance: list[list[float]]  #: of `parameters`, in their units
    #: with parameters and effects compensated; null without a workspace
    prediction: PredictionSection | None = None
    #: {component: accuracy with the effects left uncompensated}
    parameters_only: dict[str, SpreadRecord] = {}
    #: parameters for a controller that corrects geometry alone, in the units of
    #: `parameters`; empty: the parameters themselves
    controller: dict[str, float] = {}
    #: the compensation of least expected error, as in `gap.mixture.choices`
    sent: str = ""
    posterior: dict[str, Marginal] = {}  #: {name: marginal}, where the study samples
    #: joint corrections of the effects by state, which add up
    tables: list[EffectTable] = []
    not_tabled: dict[str, str] = {}  #: {effect: why no table holds it}
    warnings: list[str] = []  #: sentences that a user must know
