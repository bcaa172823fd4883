"""Hexaglide: an oracle that knows no orientation; its place in the workspace; what a
tracker loses.
"""

import numpy as np
from oracles import hexapod_geometry as oracle

from oed.base import Array
from oed.mechanism import Kinematics
from pkm_models.machines import hexaglide

MACHINE = hexaglide.machine
KINEMATICS = Kinematics(MACHINE)
NO_TOOL = np.zeros(3)


def commands(rng: np.random.Generator, n: int) -> Array:
    return rng.uniform(
        [c.lower for c in MACHINE.command], [c.upper for c in MACHINE.command], (n, 6)
    )


def test_newton_agrees_with_the_oracle(rng):
    """Carriages that stand still and struts of known length are a hexapod's feet and legs."""
    base, local = (
        np.array([points[i] for i in hexaglide.LEGS])
        for points in (hexaglide.B, hexaglide.A)
    )
    tolerance = np.array([p.tolerance for p in MACHINE.parameters])
    x, q = KINEMATICS.inverse(commands(rng, 30))
    for xi, qi in zip(x, q, strict=True):
        p = 3.0 * tolerance * rng.standard_normal(42)
        found = KINEMATICS.forward(qi[None], p, xi[None])
        rotation, point, _ = KINEMATICS.frames(found, NO_TOOL)
        carriages = base + np.column_stack([qi + p[:6], p[6:18].reshape(6, 2)])
        joints = local + p[18:36].reshape(6, 3)
        rough, about, _ = KINEMATICS.frames(xi[None], NO_TOOL)
        expected = oracle.forward(
            0.8 + p[36:], carriages, joints, about[0] + joints @ rough[0].T
        )
        assert np.abs(point[0] - expected[0]).max() < 1e-12
        assert np.abs(rotation[0] - expected[1]).max() < 1e-12


def test_no_pose_of_the_workspace_is_near_a_singular_one(rng):
    """Corners and 2000 poses between: struts in Pluecker coordinates; carriages in
    their travel and never passing.
    """
    low, high = (
        np.array([getattr(c, side) for c in MACHINE.command])
        for side in ("lower", "upper")
    )
    corners = np.array(np.meshgrid(*np.column_stack([low, high]))).reshape(6, -1).T
    x, q = KINEMATICS.inverse(np.vstack([corners, commands(rng, 2000)]))
    base, platform, _ = KINEMATICS.struts(x, q, MACHINE.nominal)
    along = (platform - base) / hexaglide.STRUT
    moment = np.cross(platform - x[:, None, :3], along) / hexaglide.PLATFORM
    values = np.linalg.svd(np.concatenate([along, moment], -1), compute_uv=False)
    assert values[:, -1].min() > 0.3
    assert values[:, 0].max() < 2.2
    # no strut is across its guide, where its carriage would move nothing
    assert np.abs(along[..., 0]).min() > 0.45
    assert all(
        c.lower < v.min() and v.max() < c.upper
        for c, v in zip(MACHINE.joints, q.T, strict=True)
    )
    assert (q[:, 1::2] - q[:, ::2]).min() > 0.9
