"""3-PRS spindle head: which of the paper's 18 errors do its own equations support?

    python docs/gallery/prs_spindle.py [FOLDER]

Wang and Fan (2004), International Journal of Machine Tools and Manufacture 44,
1171-1178. The example evaluates the same 22 poses, read by the same laser ball bar in a
known frame, with two models. The paper's model has the lengths of the struts. The full
closure adds the planes in which the revolute joints hold the struts.
"""

import _draw
import numpy as np

from oed.identifiability import Assessment, explain
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import laser_ball_bar
from pkm_models.machines import prs_spindle, prs_spindle_struts
from pkm_reports import style

#: Table 2: alpha, beta, deg
TABLE_2 = [
    (0, 0), (0, 10), (0, 20), (0, 35), (0, -10), (0, -20), (0, -35), (10, 0), (20, 0), (35, 0), (-10, 0), (-20, 0),
    (-35, 0), (5, 10), (10, 25), (-5, -10), (-10, -25), (-5, 10), (-10, 25), (5, -10), (10, -25), (25, 10),
]  # fmt: skip
COMMANDS = np.column_stack([np.full(22, 0.2), np.deg2rad(TABLE_2)])
KNOWN_FRAME = {f"{kind}_{n}": 0.0 for kind in ("shift", "turn") for n in "xyz"}
MODELS = {
    "strut lengths alone": prs_spindle_struts.machine,
    "full closure": prs_spindle.machine,
}

views: dict[str, Assessment] = {}
for name, machine in MODELS.items():
    bar = mount(
        laser_ball_bar.instrument,
        "ball_bar",
        tolerances=KNOWN_FRAME,
        at_x=0.0,
        at_y=-0.7,
        at_z=0.1,
    )
    measurement = Measurement(machine, [bar])
    views[name] = Assessment.of(measurement, [measurement.series("ball_bar", COMMANDS)])

picture = _draw.Picture(
    "Upright and tilted; the 22 tool tips", "What is left of each tolerance"
)
for command, colour in (
    ((0.2, 0.0, 0.0), style.INK),
    ((0.2, np.deg2rad(20.0), np.deg2rad(25.0)), style.BLUE),
):
    picture.machine(measurement.kinematics, np.array(command), color=colour)
picture.points(
    measurement.kinematics.inverse(COMMANDS)[0][:, :3],
    color=style.ORANGE,
    label="readings",
)
for k, (name, view) in enumerate(views.items()):
    picture.plot.barh(
        np.arange(18) + 0.36 * (k - 0.5),
        view.shrinkage,
        height=0.34,
        color=style.CYCLE[k],
        label=name,
    )
style.fixed_ticks(picture.plot, "y", list(range(18)), view.names)
picture.plot.tick_params(axis="y", labelsize=6.0)
picture.plot.invert_yaxis()
picture.plot.set(xlabel="standard deviation after / before")
picture.plot.legend(loc="lower right", fontsize=6.5, frameon=False)

shares = {
    name: dict(zip(view.names, view.shrinkage, strict=True))
    for name, view in views.items()
}
assert views["strut lengths alone"].identifiability.rank == 15
assert views["full closure"].identifiability.rank == 17
assert shares["strut lengths alone"]["dR1y"] > 0.999, (
    "the tangential offset of slider joint 1 is not in the equations"
)
assert shares["full closure"]["dR1y"] < 0.01, (
    "with the planes in the closure it is known to 1 % of its tolerance"
)


def lost_text(view: Assessment) -> str:
    """What the readings lose, in words."""
    return next(f.text for f in explain(view) if f.kind == "lost")


lost_texts = [lost_text(view) for view in views.values()]
picture.save(
    __file__, [f"{name}: {text}" for name, text in zip(views, lost_texts, strict=True)]
)
