"""Micro-CMM: what calibrated artefacts see of three legs, and the right direct
kinematics.

    python docs/gallery/micro_cmm.py [FOLDER]

The machine's 15 errors come in nine combinations: a leg tells R_f - R_p, R_f theta_f -
R_p theta_p and its zero, and nothing else. Positions in a frame that is known see all
nine. A ball plate lies where it was put, and distances have no place at all: both lose
the three motions of the machine in its plane, which no user needs. The closed form of
its paper is wrong; the corrected one agrees with Newton's method on the closure.
"""

import _draw
import numpy as np

from oed.explain import look
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
pairs = rng.permutation(
    np.vstack([balls, balls])
)  # 18 pairs of balls, first and second end
series = {
    "positions": cmm.series("positions", balls),
    "ball plate": cmm.series("ball plate", balls),
    "distances": cmm.series(
        "distances", pairs, [str(k // 2) for k in range(len(pairs))]
    ),
}
seen = {name: look(cmm, [s]) for name, s in series.items()}

_, lengths = cmm.kinematics.inverse(balls)
newton = cmm.kinematics.forward(
    lengths, machine.nominal, np.tile(machine.home_command, (len(balls), 1))
)
apart = np.abs(direct(lengths) - newton).max()
assert apart < 1e-12
found = {name: (s.verdict.rank, len(s.names)) for name, s in seen.items()}
assert found == {"positions": (9, 15), "ball plate": (12, 21), "distances": (7, 16)}
assert {"rf1": 1.0, "rp1": -1.0} in [
    {n: round(v, 6) for n, v in c.items()}
    for c in seen["positions"].verdict.named(seen["positions"].verdict.combinations)
]

picture = _draw.Picture("18 balls at two heights", "What is seen, and how well")
picture.machine(cmm.kinematics)
picture.points(balls)
for k, (name, s) in enumerate(seen.items()):
    values = s.verdict.identifiable
    picture.plot.plot(
        np.arange(1, len(values) + 1), values, marker=style.marker(k), color=style.CYCLE[k], ms=3.5, lw=1.0,
        label=f"{name}: {len(values)} of {len(s.names)}",
    )  # fmt: skip
style.log_axis(picture.plot, "y")
picture.plot.set(xlabel="direction, best seen first", ylabel="singular value")
picture.plot.legend(fontsize=6.5, frameon=False)
picture.save(
    __file__,
    [
        f"closed form and Newton are {apart:.0e} m apart over the workspace",
        *(
            f"{name}: {rank} of {n} directions seen"
            for name, (rank, n) in found.items()
        ),
    ],
)
