"""A small study whose virtual machine has backlash, and its diagnosis by hand.

The diagnosis knows the true effect: it is generalised least squares of the effect's
columns in the metric of the noise and the parameters, in dense matrices. It shares no
code with the search for effects.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from kernel.laws import STATED_LAW

from oed.base.arrays import Array
from oed.gap.data.diagnosis import AnswerContent, Diagnosis, Size
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import signature
from oed.model.effect import Column, Effect, State
from oed.result.gap import (
    AnswerRecord,
    ClosureRecord,
    CoefficientRecord,
    PlaceRecord,
)

STUDY = """\
schema = 1
name = "small_gap"
title = "A3 head that has backlash"
question = "What is wrong with this head?"
seed = 3

[machine]
model = "a3_head"

[[setup]]
name = "cup"
instrument = "ball_bar"
length_mm = 300.0
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }
both_directions = true
average = false

[noise]
length_um = 0.5

[design]

[[design.reference]]
name = "two circles"
setup = "cup"
z_mm = [1146.0, 1206.0]
psi_deg = { from = 0.0, to = 360.0, count = 24, endpoint = false }
theta = "hold"
runs_by = "z"

[readings]
simulate = true
draw = true

[posterior]
enabled = false

[report]
html = false
pdf = false

[gap]
effects = ["effects.py:backlash", "effects.py:cold"]

[gap.conditions]
start_min = 10
reading_s = 2.0
setup_min = 5
pause_s = 60
feed_mm_min = [500, 1000]
payload_N = 50

[[gap.acting]]
effect = "effects.py:backlash"
coefficients = { "leg 2" = 2.0, "leg 3" = -0.5 }
size = 1.5
"""

#: a user's own file of effects
EFFECTS = '''\
"""Effects of one's own."""

from oed.model.effect import Column, Effect


def _backlash(state, reach=1.0):
    for i in state.limbs:
        gap = reach * 0.5 * state.motion_sign[:, i]
        yield Column(f"leg {i + 1}", 5e-6, label=f"leg {i + 1}", joints={i: gap})
    yield Column("adapting", 1e-6, joints={0: state.motion_sign[:, 0] * state.joints[:, 0]}, shape=True)


backlash = Effect(
    name="backlash",
    source="by hand",
    about="lost motion of each joint where it turns round",
    columns=_backlash,
    needs=("direction: both",),
    constants={"reach": (0.5, 1.0, 2.0)},
    remedy="preload the screws or correct the reversal in the controller",
    exposed_by="each circle both ways",
)

cold = Effect(
    name="cold",
    source="by hand",
    about="cooling of the frame",
    columns=lambda state: [Column("all", 1e-5, reading={"*": state.temperature["frame"]})],
    needs=("temp_frame",),
)
'''


def written(folder: Path, text: str = STUDY) -> Path:
    """The study and its effects in a folder."""
    (folder / "effects.py").write_text(EFFECTS, encoding="utf-8")
    path = folder / "small.study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _columns(state: State) -> Iterable[Column]:
    for i in state.limbs:
        yield Column(
            f"leg {i + 1}",
            5e-6,
            label=f"leg {i + 1}",
            joints={i: 0.5 * state.motion_sign[:, i]},
        )


backlash = Effect(
    name="backlash", source="by hand", about="lost motion", columns=_columns
)


#: the best answer
ACTS = AnswerRecord(("backlash",), 0.97, (("backlash", "friction"),))


def diagnosis(problem: GapProblem) -> Diagnosis:
    """The diagnosis of someone who knows that backlash is the cause."""
    columns = signature(
        backlash,
        {},
        problem.states,
        problem.responses,
        problem.measurement,
        problem.series,
    )
    signatures = 2.0 * problem.in_noise_units(columns.columns)
    slopes, residual, sigma = problem.slopes, problem.residual, problem.sigma
    covariance = np.eye(len(problem)) + slopes @ slopes.T
    mean, sd = _posterior(signatures, covariance, residual)
    explained = signatures @ mean
    unexplained = residual - explained
    rms, remaining = (
        {"length": float(np.sqrt(np.mean((part * sigma) ** 2)))}
        for part in (explained, explained - _absorbed(slopes, explained))
    )
    scales = 2.0 * np.asarray(columns.scales)
    return Diagnosis(
        problem=problem,
        verdict="effect",
        answers=(
            ACTS,
            AnswerRecord((), 0.02),
            AnswerRecord(("backlash", "unknown"), 0.01),
        ),
        set95=(ACTS,),
        marginal={"cold": 0.01, "backlash": 0.98},
        law=STATED_LAW,
        noise_words=("The noise is as stated.",),
        constants={},
        coefficients=_coefficients(columns.names, mean * scales, sd * scales),
        sizes=(Size("backlash", rms, remaining, 41.0),),
        explained=explained * sigma,
        unexplained=np.zeros(len(problem)),
        likeness={},
        nearest=(),
        before=(residual - _absorbed(slopes, residual)) * sigma,
        after=(unexplained - _absorbed(slopes, unexplained)) * sigma,
        where=_places(problem),
        closure=(
            ClosureRecord("within", 0.96, 0.91, 0.99, 0.001, 30.0, 2.2, 1.0, 96),
            ClosureRecord("whole", np.nan, np.nan, np.nan, np.nan, 1.0, 1.0, 1.0, 96),
        ),
        not_testable={"cold": "the readings do not have temp_frame"},
        confusable=(("backlash", "friction"),),
        next=("Read each circle both ways again.",),
        contents=(
            AnswerContent({"backlash": {}}, unknown=False),
            AnswerContent({}, unknown=False),
            AnswerContent({"backlash": {}}, unknown=True),
        ),
    )


def _coefficients(
    names: Sequence[str], means: Array, sds: Array
) -> tuple[CoefficientRecord, ...]:
    return tuple(
        CoefficientRecord("backlash", name, name, float(mean), float(sd), "SI", None)
        for name, mean, sd in zip(names, means, sds, strict=True)
    )


def _places(problem: GapProblem) -> tuple[PlaceRecord, ...]:
    runs = dict.fromkeys(problem.rows["run"])
    return (
        PlaceRecord("leg 2", 0.002, 0.9),
        *[PlaceRecord(f"run {run}", 0.4, 0.1) for run in runs],
        PlaceRecord("leg 1", 0.7, None),
    )


def _posterior(
    g: Array,
    covariance: Array,
    r: Array,
) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) of coefficients with prior N(0, 1)."""
    weighted = np.linalg.solve(covariance, np.column_stack([g, r]))
    normal = g.T @ weighted
    posterior = np.linalg.inv(np.eye(g.shape[1]) + normal[:, :-1])
    return posterior @ normal[:, -1], np.sqrt(np.diag(posterior))


def _absorbed(h: Array, r: Array) -> Array:
    """Part of residuals r that parameters with prior N(0, 1) explain."""
    information = np.eye(h.shape[1]) + h.T @ h
    return np.asarray(h @ np.linalg.solve(information, h.T @ r))
