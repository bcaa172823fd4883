"""A3 spindle head: the published plan of two ball-bar circles against thirty readings
chosen by D-optimality.

    python docs/gallery/a3_head.py [FOLDER]

Two circles of 15 readings see 18 of 21 parameters, as any plan with one tool does.
Thirty readings chosen out of 1512 see the same 18 better: the two circles have a
D-efficiency of 68 %, so 44 readings of theirs are worth these 30. The condition number
of two circles has its minimum at 15 points, but no plateau after it.
"""

import _draw
import numpy as np

from oed import identifiability, information
from oed.design import exchange
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import ball_bar
from pkm_models.machines.a3_head import C, D, machine
from pkm_reports import style

HOME, ROUND = C + D, 2.0 * np.pi
bar = Measurement(
    machine, [mount(ball_bar.instrument, "cup", teach=(HOME + 0.220, 0.0, 0.0))]
)


def held(strokes: np.ndarray, points: int) -> np.ndarray:
    """Commands (n, 3) on circles at some strokes (m); theta is led by the bar."""
    stroke, psi = (
        v.ravel()
        for v in np.meshgrid(strokes, np.linspace(0.0, ROUND, points, endpoint=False))
    )
    command, possible = bar.hold(
        "cup", np.column_stack([HOME + stroke, psi, 0.0 * psi]), "theta"
    )
    assert possible.all()
    return command


def rows(command: np.ndarray) -> np.ndarray:
    """H (n, 21) of readings at some commands, all parameters as lengths."""
    return information.scaled(bar, [bar.series("cup", command)], bar.nominal, "length")[
        :, bar.free
    ]


def singular(command: np.ndarray) -> np.ndarray:
    """The 18 singular values that are not zero."""
    return np.linalg.svd(rows(command), compute_uv=False)[:18]


circles, grid = (
    held(np.array([0.080, 0.200]), 15),
    held(np.linspace(0.0, 0.200, 21), 72),
)
names = [n for n, free in zip(bar.names, bar.free, strict=True) if free]
verdict = identifiability.analyse(rows(grid), names, 1.0 / bar.lengths[bar.free])
assert (verdict.rank, len(names)) == (18, 21)  # all 1512 candidates together

chosen = exchange.choose(rows(grid), 30, np.random.default_rng(1), "D", rounds=3)
of_paper, of_choice = (
    2.0 * np.log(singular(c)).sum() for c in (circles, grid[chosen.indices])
)
efficiency = np.exp((of_paper - of_choice) / 18.0)
assert abs(of_paper + 65.58) < 0.01
assert of_choice > -58.80
assert 0.67 < efficiency < 0.69

counts = np.arange(12, 21)
kappa = np.array(
    [(s := singular(held(np.array([0.080, 0.200]), n)))[0] / s[-1] for n in counts]
)
assert counts[kappa.argmin()] == 15
assert (
    kappa[counts > 15].min() > 1.1 * kappa.min()
)  # the minimum, but no plateau after it

picture = _draw.Picture("Thirty readings", "Condition number of two circles")
picture.machine(bar.kinematics, np.array([HOME + 0.080, 0.9, np.deg2rad(30.0)]))
plans = (
    (circles, "two circles", of_paper),
    (grid[chosen.indices], "chosen", of_choice),
)
for (command, name, value), shade, marker in zip(
    plans, (style.ORANGE, style.BLUE), "oD", strict=True
):
    x, _ = bar.kinematics.inverse(command)
    picture.points(
        x[:, :3], color=shade, marker=marker, label=f"{name}, log det {value:.1f}"
    )
picture.plot.plot(counts, kappa, "o-", color=style.BLUE)
picture.plot.set_xlabel("readings a circle")
picture.plot.set_ylabel("largest over 18th singular value")
picture.plot.set_ylim(0.0, 6000.0)
picture.save(
    __file__,
    [
        (
            f"{verdict.rank} of {len(names)} parameters are seen by 1512 readings with"
            " one tool"
        ),
        (
            f"log det {of_paper:.2f} for two circles of 15, {of_choice:.2f} for 30"
            f" chosen: efficiency {efficiency:.0%}"
        ),
        f"condition number {kappa[3]:.0f} for 15 a circle, {kappa[4]:.0f} for 16",
    ],
)
