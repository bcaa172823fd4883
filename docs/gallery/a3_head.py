"""A3 spindle head: the published two ball-bar circles against thirty D-optimal readings.

    python docs/gallery/a3_head.py [FOLDER]

Two circles of 15 readings see 18 of 21 parameters, as any plan of bar readings with one
tool does.
Thirty readings chosen out of 1512 see the same 18 better: the two circles have a
D-efficiency of 68 %, so 44 of their readings are worth these 30. The condition number
of two circles alone has its minimum at 15 points, but no plateau after it.
"""

import _draw
import numpy as np

from oed.design import choose
from oed.identifiability import analyse, scaled
from oed.instrument import mount
from oed.measurement import Measurement, commands_at_fixed_reading
from pkm_models.instruments import ball_bar
from pkm_models.machines.a3_head import C, D, machine
from pkm_reports import style

HOME, FULL_TURN = C + D, 2.0 * np.pi
cup = mount(ball_bar.instrument, "cup", teach=(HOME + 0.220, 0.0, 0.0))
bar = Measurement(machine, [cup])


def on_circles(strokes: np.ndarray, points: int) -> np.ndarray:
    """Commands (n, 3) on circles at some strokes (m); the bar leads theta."""
    angles = np.linspace(0.0, FULL_TURN, points, endpoint=False)
    stroke, psi = (axis.ravel() for axis in np.meshgrid(strokes, angles))
    start = np.column_stack([HOME + stroke, psi, 0.0 * psi])
    command, possible = commands_at_fixed_reading(bar, "cup", start, "theta")
    assert possible.all()
    return command


def identification_matrix(command: np.ndarray) -> np.ndarray:
    """H (n, 21) of readings at some commands, all parameters as lengths."""
    series = [bar.series("cup", command)]
    h = scaled(bar, series, bar.nominal, "length")
    return h[:, bar.free]


def singular_values(command: np.ndarray) -> np.ndarray:
    """The 18 singular values that are not zero."""
    h = identification_matrix(command)
    return np.linalg.svd(h, compute_uv=False)[:18]


def log_det(command: np.ndarray) -> float:
    """Log det of the information about the 18 directions."""
    return 2.0 * float(np.log(singular_values(command)).sum())


def condition_number(points: int) -> float:
    """Of the paper's two circles with so many points each."""
    values = singular_values(on_circles(STROKES, points))
    return float(values[0] / values[-1])


STROKES = np.array([0.080, 0.200])
circles = on_circles(STROKES, 15)
grid = on_circles(np.linspace(0.0, 0.200, 21), 72)
candidates = identification_matrix(grid)
names = np.array(bar.names)[bar.free]
verdict = analyse(candidates, names, 1.0 / bar.length_factors[bar.free])
assert (verdict.rank, len(names)) == (18, 21)  # all 1512 candidates together

chosen = choose(candidates, 30, np.random.default_rng(1), "D", rounds=3)
published_value, chosen_value = log_det(circles), log_det(grid[chosen.indices])
efficiency = np.exp((published_value - chosen_value) / 18.0)
assert abs(published_value + 65.58) < 0.01
assert chosen_value > -58.80
assert 0.67 < efficiency < 0.69

counts = np.arange(12, 21)
kappa = np.array([condition_number(n) for n in counts])
assert counts[kappa.argmin()] == 15
more_points = kappa[counts > 15]
assert more_points.min() > 1.1 * kappa.min()  # the minimum, but no plateau after it

picture = _draw.Picture("Thirty readings", "Condition number of two circles")
tilted = np.array([HOME + 0.080, 0.9, np.deg2rad(30.0)])
picture.machine(bar.kinematics, tilted)
plans = (
    (circles, "two circles", published_value),
    (grid[chosen.indices], "chosen", chosen_value),
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
            f"log det {published_value:.2f} for two circles of 15, {chosen_value:.2f} for 30"
            f" chosen: efficiency {efficiency:.0%}"
        ),
        f"condition number {kappa[3]:.0f} for 15 a circle, {kappa[4]:.0f} for 16",
    ],
)
