"""Cable robot: four lines for three degrees of freedom test the model by themselves.

    python docs/gallery/cable_robot.py [FOLDER]

A virtual Hangprinter is moved by hand while its motors are read; a camera observes nine
poses. These nine identify anchors, spools and line lengths. In 35 other poses the place
is unknown, but four lines meet in one point only on the right machine. Their gap falls
from centimetres to the noise of a line. The study `hangprinter_hp4` does the same with
real readings.
"""

import _draw
import numpy as np

from oed import compensate
from oed.estimation import identify
from oed.instrument import mount
from oed.measurement import Measurement, draw_parameters
from pkm_models.instruments import camera, redundancy
from pkm_models.machines.cable_robot import FOLD, GEAR, LINES, SPOOL, machine
from pkm_reports import style

OBSERVED, UNOBSERVED, LINE_NOISE = 9, 35, 0.3e-3  # poses, poses, m
rng = np.random.default_rng(11)
robot = Measurement(
    machine,
    [mount(camera.known_frame, "camera"), mount(redundancy.instrument, "lines")],
)
truth = draw_parameters(robot, rng)
LOW, HIGH = (-0.35, -0.35, 0.0), (0.35, 0.35, 1.2)  # m
places = rng.uniform(LOW, HIGH, (OBSERVED + UNOBSERVED, 3))
motors = compensate.compensated_joints(
    robot.kinematics, places, truth
)  # taut lines at each place
motor_per_metre = (
    np.array([FOLD[i] for i in LINES]) * GEAR / SPOOL
)  # of a motor, rad for a metre of line
motors += LINE_NOISE * motor_per_metre * rng.standard_normal(motors.shape)

observed = [
    robot.series_from_joints(name, motors[:OBSERVED]) for name in ("camera", "lines")
]
camera_readings = places[:OBSERVED] + 1e-3 * rng.standard_normal((OBSERVED, 3))
estimate = identify(
    robot, observed, np.concatenate([camera_readings.ravel(), np.zeros(OBSERVED)])
)
unobserved = robot.series_from_joints("lines", motors[OBSERVED:])
before, after = (
    1e3 * robot.readings([unobserved], theta)
    for theta in (robot.nominal, estimate.theta)
)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


assert rms(before) > 5.0
assert rms(after) < 1.0
assert np.abs((estimate.theta - truth) / estimate.sd).max() < 4.0

picture = _draw.Picture("Nine known poses, 35 others", "Gap that four lines leave")
picture.machine(robot.kinematics)
picture.points(places[OBSERVED:], color=style.GREY, ms=2.0, label="unknown")
picture.points(places[:OBSERVED], label="observed by the camera")
for values, colour, name in (
    (before, style.GREY, "nominal"),
    (after, style.BLUE, "identified"),
):
    picture.plot.plot(
        np.abs(values),
        color=colour,
        marker="o",
        ms=3.0,
        lw=0.6,
        label=f"{name}: rms {rms(values):.2g} mm",
    )
style.log_axis(picture.plot, "y")
picture.plot.set(xlabel="pose", ylabel="gap [mm]")
picture.plot.set_ylim(0.02, 300.0)
picture.plot.legend(loc="upper right", fontsize=6.5, frameon=False)
picture.save(
    __file__,
    [
        f"gap of the 35 other poses: {rms(before):.1f} mm before, {rms(after):.2f} mm"
        " after"
    ],
)
