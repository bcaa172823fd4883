"""Micro-CMM: what artefacts see of three legs, and the correct direct kinematics.

    python docs/gallery/micro_cmm.py [FOLDER]

The machine's 15 errors appear in nine combinations: for each leg R_f - R_p,
R_f theta_f - R_p theta_p and its zero. Positions in a known frame see all nine. A ball
plate has an unknown place, and distances have none. Both lose the three motions of the
machine in its plane, which no user needs. The closed form from its leg equations agrees
with Newton's method on the closure.
"""

import _draw
import numpy as np

from oed.identifiability import Assessment
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import ball_plate, camera
from pkm_models.machines.micro_cmm import direct, machine
from pkm_reports import style

cmm = Measurement(
    machine,
    [
        mount(camera.known_frame, "positions"),
        mount(ball_plate.instrument, "ball plate", at_z=-0.2),
        mount(ball_plate.distance, "distances"),
    ],
)
side, heights = (-0.035, 0.0, 0.035), (-0.24, -0.16)
balls = np.array([(x, y, z) for z in heights for x in side for y in side])
rng = np.random.default_rng(5)
ends = np.vstack([balls, balls])
pairs = rng.permutation(ends)  # 18 pairs of balls, first and second end
pair_names = [str(k // 2) for k in range(len(pairs))]
series = {
    "positions": cmm.series("positions", balls),
    "ball plate": cmm.series("ball plate", balls),
    "distances": cmm.series("distances", pairs, pair_names),
}
views = {name: Assessment.of(cmm, [s]) for name, s in series.items()}

_, lengths = cmm.kinematics.inverse(balls)
start = np.tile(machine.home_command, (len(balls), 1))
newton = cmm.kinematics.forward(lengths, machine.nominal, start)
difference = np.abs(direct(lengths) - newton).max()
assert difference < 1e-12
ranks = {name: (s.identifiability.rank, len(s.names)) for name, s in views.items()}
assert ranks == {"positions": (9, 15), "ball plate": (12, 21), "distances": (7, 16)}
verdict = views["positions"].identifiability
combinations = verdict.coefficients_by_name(verdict.combinations)
rounded = [{n: round(v, 6) for n, v in c.items()} for c in combinations]
assert {"rf1": 1.0, "rp1": -1.0} in rounded

picture = _draw.Picture("18 balls at two heights", "What is seen, and how well")
picture.machine(cmm.kinematics)
picture.points(balls)
for k, (name, view) in enumerate(views.items()):
    values = view.identifiability.identifiable_singular_values
    label = f"{name}: {len(values)} of {len(view.names)}"
    appearance = {"marker": style.marker(k), "color": style.CYCLE[k]}
    numbers = np.arange(1, len(values) + 1)
    picture.plot.plot(numbers, values, **appearance, ms=3.5, lw=1.0, label=label)
style.log_axis(picture.plot, "y")
picture.plot.set(xlabel="direction, best seen first", ylabel="singular value")
picture.plot.legend(fontsize=6.5, frameon=False)
picture.save(
    __file__,
    [
        f"closed form and Newton are {difference:.0e} m apart over the workspace",
        *(
            f"{name}: {rank} of {n} directions seen"
            for name, (rank, n) in ranks.items()
        ),
    ],
)
