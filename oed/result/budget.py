"""Uncertainty budget: the section `budget` of a prediction in result.json."""

from __future__ import annotations

from oed.result.record import Record


class BudgetLine(Record, frozen=True):
    """A source of the errors of the compensated machine; values by pose component.

    source   its name
    kind     instrument, run, course, noise law, set-up, effects, prior or linearisation;
             with a compensation file also interpolation, rounding or left out
    share    of the predicted variance; below 0 where a linear calculation predicts too
             much
    size     root of its variance, in the component's unit, with the sign of its share
    without  rms error without it, the estimate adapted; null where nobody can remove it
    halved   rms error with half its standard deviation, or null
    """

    source: str
    kind: str
    share: dict[str, float]
    size: dict[str, float]
    without: dict[str, float] | None = None
    halved: dict[str, float] | None = None


class UnmodelledLine(Record, frozen=True):
    """Expected errors by an effect that the model lacks; values by pose component.

    size          rms error that it adds through calibration to the workspace
    with_it       rms error of the compensated machine with it
    expected      its expected size, in words
    far           rms error with it at 30 times that size, the largest usual one
    not_testable  why the readings cannot find it; null where they can
    """

    effect: str
    about: str
    expected: str
    size: dict[str, float]
    with_it: dict[str, float]
    remedy: str
    not_testable: str | None = None
    far: dict[str, float] = {}


class UsualEffects(Record, frozen=True):
    """Accuracy of a machine with all usual effects at their expected sizes.

    Values are rms errors by pose component, of those that the drives correct; of all where
    they correct none.

    effects     their names
    unmodelled  where the calibration knows none of them
    fitted      where all are fitted with the parameters, and corrected with them
    """

    effects: list[str]
    unmodelled: dict[str, float]
    fitted: dict[str, float]


class BudgetSection(Record, frozen=True):
    """Sources of the errors that remain, each component in its fine unit.

    predicted   rms error that the lines add up to; of what no drive corrects, with
                further axes that take the known error back
    no_axes     rms error of what no drive corrects, without further axes
    lines       of what the prediction contains
    unmodelled  effects that it does not contain, at their expected sizes, the one that
                adds most first
    usual       the machine with all of these; null where none are listed
    advice      what to improve first, in sentences
    """

    predicted: dict[str, float]
    lines: list[BudgetLine]
    unmodelled: list[UnmodelledLine] = []
    usual: UsualEffects | None = None
    advice: list[str] = []
    no_axes: dict[str, float] = {}
