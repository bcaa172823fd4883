"""Scenes of the blind benchmark with their stage and metric, for the generator's tests."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np


def stage_of(
    blind: SimpleNamespace, machine: str, plan: str, seed: int = 3
) -> SimpleNamespace:
    """A scene with its stage, metric under white noise, and law."""
    rng = np.random.default_rng(seed)
    plan_drawn = blind.plans.draw(rng, machine, plan)
    scene = blind.scene.draw(rng, plan_drawn)
    stage = blind.base.Stage(
        plan_drawn, scene.motion, scene.layout, blind.thermal.climate(rng, plan_drawn)
    )
    sigma = blind.noise.covariance(
        blind.noise.Law(name="white"), blind.noise.grouping(plan_drawn, scene.layout)
    )
    metric = blind.severity.Metric(sigma, scene.J, scene.prior)
    return SimpleNamespace(
        plan=plan_drawn, scene=scene, stage=stage, metric=metric, sigma=sigma
    )
