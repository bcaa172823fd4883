"""What is known of the machine over all answers of a diagnosis: `gap.mixture`."""

from __future__ import annotations

from typing import Final

from oed.result.prediction import PredictionSection
from oed.result.record import Probability, Record, Size

#: names of the compensations that are compared
MIXTURE: Final = "mixture"
BEST: Final = "best answer"
BEST_WITH_EFFECTS: Final = "best answer with effects"
PLAIN: Final = "plain fit"
NOTHING: Final = "nothing"


class MixedAnswer(Record, frozen=True):
    """An answer that the mixture holds, with its probability by the diagnosis.

    effects  that act, `unknown` for something of no known form; none: no gap
    unseen   whether small effects of one common size act as well
    """

    effects: tuple[str, ...]
    probability: Probability
    unseen: bool = False


class MixedParameter(Record, frozen=True):
    """A parameter over all answers, in `unit`.

    within     standard deviation that the answers have on average; the rest of `sd` is
               between them
    low, high  ends of the 95 % interval, quantiles of the mixture
    """

    value: float
    sd: float
    within: Size
    low: float
    high: float
    unit: str


class CompensationChoice(Record, frozen=True):
    """A compensation, and the rms error that all answers expect of it.

    name  `plain fit` (no effect in the model), `best answer` or `mixture`, each with the
          geometry alone; `best answer with effects`, where effects are corrected;
          `nothing`
    rms   {component: in its fine unit}
    """

    name: str
    rms: dict[str, float]


class MixtureSection(Record, frozen=True):
    """Parameters and accuracy over all answers of a diagnosis.

    answers     that were fitted, the decision's first
    rest        probability of all others
    controller  parameters for a controller that corrects geometry alone, in the units of
                `parameters`: those of `sent`
    sent        the choice of least expected error with the geometry alone; `mixture` is
                the mean, shifted so that it takes up what is known of the effects
    covariance  of `parameters`, in their units
    choices     compensations and what all answers expect of each
    prediction  with `controller` sent, over all answers; null without a workspace
    with_effects  the same with the parameters and the effects of the best answer sent;
                null where none is corrected, or that is expected to be worse
    words       in sentences
    """

    answers: list[MixedAnswer]
    rest: float
    parameters: dict[str, MixedParameter]
    covariance: list[list[float]]
    controller: dict[str, float] = {}
    sent: str = MIXTURE
    choices: list[CompensationChoice] = []
    prediction: PredictionSection | None = None
    with_effects: PredictionSection | None = None
    words: list[str] = []
