"""A small study with a virtual machine that has backlash, and a diagnosis of its
readings made by hand.

The diagnosis is made with the true effect known: generalised least squares of its
columns in the metric of the noise and the parameters, in dense matrices. Nothing of the
search for effects is in it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from oed.arrays import Array
from oed.effect import Column, Effect, State
from oed.gap.data.diagnosis import Answer, Block, Closure, Coefficient, Diagnosis, Size
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import signature
from oed.noise.law import stated

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

from oed.effect import Column, Effect


def _backlash(state, reach=1.0):
    for i in state.limbs:
        gap = reach * 0.5 * state.sense[:, i]
        yield Column(f"leg {i + 1}", 5e-6, label=f"leg {i + 1}", joints={i: gap})
    yield Column("adapting", 1e-6, joints={0: state.sense[:, 0] * state.joints[:, 0]}, shape=True)


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
            joints={i: 0.5 * state.sense[:, i]},
        )


backlash = Effect(
    name="backlash", source="by hand", about="lost motion", columns=_columns
)


def diagnosis(problem: GapProblem) -> Diagnosis:
    """The diagnosis of someone who knows that backlash is the cause."""
    found = signature(
        backlash,
        {},
        problem.states,
        problem.responses,
        problem.measurement,
        problem.series,
    )
    g, h = 2.0 * problem.in_noise_units(found.columns), problem.slopes
    noise = np.eye(len(problem))
    spread = noise + h @ h.T
    beta, sd = _posterior(g, spread, problem.residual)
    explained = g @ beta
    before = problem.residual - _absorbed(h, problem.residual)
    after = problem.residual - explained - _absorbed(h, problem.residual - explained)
    sigma = problem.sigma
    runs = dict.fromkeys(problem.rows["run"])
    yes, no = Answer(("backlash",), 0.97, (("backlash", "friction"),)), Answer((), 0.02)
    return Diagnosis(
        problem=problem,
        verdict="effect",
        answers=(yes, no, Answer(("backlash", "unknown"), 0.01)),
        set95=(yes,),
        marginal={"cold": 0.01, "backlash": 0.98},
        law=stated(problem),
        noise_words=("The noise is as stated.",),
        constants={},
        coefficients=tuple(
            Coefficient("backlash", n, n, float(b * s * 2.0), float(e * s * 2.0))
            for n, b, e, s in zip(found.names, beta, sd, found.scales, strict=True)
        ),
        sizes=(
            Size(
                "backlash",
                {"length": float(np.sqrt(np.mean((explained * sigma) ** 2)))},
                41.0,
            ),
        ),
        explained=explained * sigma,
        unexplained=np.zeros(len(problem)),
        likeness={},
        before=before * sigma,
        after=after * sigma,
        where=(
            Block("leg 2", 0.002, 0.9),
            *(Block(f"run {r}", 0.4, 0.1) for r in runs),
            Block("leg 1", 0.7, np.nan),
        ),
        closure=(
            Closure("within", 0.96, 0.91, 0.99, 0.001, 30.0, 2.2, 1.0, 96),
            Closure("whole", np.nan, np.nan, np.nan, np.nan, 1.0, 1.0, 1.0, 96),
        ),
        not_testable={"cold": "the readings do not have temp_frame"},
        confusable=(("backlash", "friction"),),
        next=("Read each circle both ways again.",),
    )


def _posterior(g: Array, spread: Array, r: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of coefficients with prior N(0, 1)."""
    inner = g.T @ np.linalg.solve(spread, np.column_stack([g, r]))
    covariance = np.linalg.inv(np.eye(g.shape[1]) + inner[:, :-1])
    return covariance @ inner[:, -1], np.sqrt(np.diag(covariance))


def _absorbed(h: Array, r: Array) -> Array:
    """What the parameters, with prior N(0, 1), take of residuals r."""
    return np.asarray(h @ np.linalg.solve(np.eye(h.shape[1]) + h.T @ h, h.T @ r))


def two_channels(found: Diagnosis) -> Diagnosis:
    """The same with every number in doubt: NaN where a number may be missing."""
    return dataclasses.replace(
        found,
        closure=(dataclasses.replace(found.closure[0], value=np.nan, p_worse=np.nan),),
    )
