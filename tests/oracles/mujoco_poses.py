"""Oracle: poses of a closed mechanism by MuJoCo's own kinematics and Jacobians.

Newton's method moves the passive joints of a model until the points of its loops
coincide. It must never import the toolkit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Loop = tuple[int, Array, int, Array]  #: body and point on it (3,), twice


def connections(mujoco: Any, model: Any) -> list[Loop]:
    """Loops that `equality/connect` closes, between bodies or between sites."""
    loops = []
    for k in range(model.neq):
        first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
            bodies, places = model.site_bodyid, model.site_pos
            ends = [(int(bodies[s]), places[s]) for s in (first, second)]
        else:
            data = model.eq_data[k]
            ends = [(first, data[:3]), (second, data[3:6])]
        loops.append((*ends[0], *ends[1]))
    return loops


def close(
    mujoco: Any, model: Any, data: Any, joints: dict[str, float], loops: list[Loop]
) -> float:
    """Set driven joints, close the loops from where the model is; the largest gap, m."""
    driven = []
    for name, value in joints.items():
        joint = model.joint(name)
        data.qpos[joint.qposadr[0]] = value
        driven.append(int(joint.dofadr[0]))
    passive = [k for k in range(model.nv) if k not in driven]
    gap = np.inf
    for _ in range(30):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        gaps, rows = [], []
        for a, on_a, b, on_b in loops:
            sides = []
            for body, local in ((a, on_a), (b, on_b)):
                point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ local
                slope = np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, slope, None, point, body)
                sides.append((point, slope))
            gaps.append(sides[0][0] - sides[1][0])
            rows.append((sides[0][1] - sides[1][1])[:, passive])
        gap = float(np.abs(gaps).max())
        if gap < 1e-14:
            break
        step = np.zeros(model.nv)
        step[passive] = -np.linalg.lstsq(np.vstack(rows), np.ravel(gaps), rcond=None)[0]
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    return gap
