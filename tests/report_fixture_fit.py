"""A made-up fit: estimate, posterior, residual accuracy, held-out readings."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from report_fixture_machine import CUPS, NAMES, TILTS

from oed.result.prediction import LEVELS

COMPONENTS = {
    "x": "um",
    "y": "um",
    "z": "um",
    "psi": "arcsec",
    "theta": "arcsec",
    "phi": "arcsec",
}
#: size of each component's error against that of z
SCALES = {
    "x": 0.85,
    "y": 0.8,
    "z": 1.0,
    "psi": 2.1,
    "theta": 0.08,
    "phi": 0.5,
}
DIRECTIONS = [
    "spin about the TCP",
    "tilt x about TCP",
    "tilt y about TCP",
    "db1y",
    "0.7 db2x - 0.7 db3x",
]


def estimate(rng: np.random.Generator) -> dict[str, Any]:
    """A fit of 30 readings."""
    wave = 60.0 * np.sin(np.linspace(0, 12, 30))
    before = wave + 25.0 * rng.normal(size=30)
    after = 0.5 * rng.normal(size=30)
    iterations = [
        {
            "step": float(k),
            "rms_um": 50.0 * 0.05**k + 0.41,
            "damping": 10.0**-k,
        }
        for k in range(4)
    ]
    return {
        "parameters": {name: _parameter(name, rng) for name in NAMES},
        "rms_before": {"length": float(np.sqrt(np.mean(before**2)))},
        "rms_after": {"length": float(np.sqrt(np.mean(after**2)))},
        "units": {"length": "um"},
        "channels": ["length"] * 30,
        "readings": 30,
        "dof": 9.0,
        "chi2": 10.2,
        "iterations": iterations,
        "warnings": ["9 degrees of freedom: chi2 says little about the noise."],
        "residuals": after.tolist(),
        "residuals_before": before.tolist(),
    }


def _parameter(name: str, rng: np.random.Generator) -> dict[str, Any]:
    prior = 10.0 if name in TILTS else 0.02 if name in CUPS else 1.0
    sd = prior * float(np.exp(rng.uniform(math.log(2e-3), 0.0)))
    truth = float(prior * rng.normal())
    return {
        "value": truth + sd * float(rng.normal()),
        "sd": sd,
        "unit": "mrad" if name in TILTS else "mm",
        "nominal": 0.0,
        "prior_sd": prior,
        "identified": _verdict(sd / prior),
        "truth": truth,
    }


def _verdict(shrinkage: float) -> str:
    if shrinkage < 0.3:
        return "seen"
    return "weak" if shrinkage < 0.9 else "prior"


def posterior(rng: np.random.Generator) -> dict[str, Any]:
    """2000 draws of five directions, and a marginal of each parameter."""
    marginals = {name: _marginal(name, rng) for name in NAMES}
    mix = np.array(
        [
            [1.0, 0.0, 0.0, 0.0, 0.0],
            [0.1, 0.95, 0.0, 0.0, 0.0],
            [0.0, 0.4, 0.6, 0.0, 0.0],
            [0.0, 0.0, 0.2, 0.3, 0.0],
            [0.0, 0.0, 0.0, 0.1, 0.1],
        ]
    )
    draws = rng.normal(size=(2000, 5)) @ mix.T + [0.0, 0.1, -0.6, 0.4, 1.2]
    return {
        "marginals": marginals,
        "acceptance": 0.27,
        "draws": 40000,
        "walkers": 96,
        "autocorrelation": 31.4,
        "directions": DIRECTIONS,
        "corner": np.round(draws, 4).tolist(),
    }


def _marginal(name: str, rng: np.random.Generator) -> dict[str, Any]:
    mean, sd = float(rng.normal()), float(0.02 + 0.5 * rng.random())
    return {
        "mean": mean,
        "sd": sd,
        "q025": mean - 1.96 * sd,
        "q975": mean + 1.96 * sd,
        "rhat": float(1.0 + 0.008 * rng.random()),
        "ess": float(rng.integers(1050, 4000)),
        "unit": "mrad" if name in TILTS else "mm",
    }


# -- residual accuracy -----------------------------------------------------------------


def prediction(rng: np.random.Generator) -> dict[str, Any]:
    """Accuracy of the head over 144 poses, with a virtual machine."""
    parts = {
        name: _component(name in ("z", "psi", "theta"), unit, SCALES[name])
        for name, unit in COMPONENTS.items()
    }
    points = [
        _map_point(z, psi, theta)
        for z in (1066.0, 1166.0, 1266.0)
        for theta in (5.0, 15.0, 25.0, 35.0)
        for psi in range(0, 360, 30)
    ]
    realised = {}
    for name, unit in COMPONENTS.items():
        ratio = float(rng.uniform(0.85, 1.15))
        realised[name] = spread(ratio * parts[name]["after"]["rms"], unit)
    return {
        "reference": "home",
        "components": parts,
        "unit": COMPONENTS,
        "poses": len(points),
        "map": points,
        "mode": "identified",
        "realised": realised,
    }


def delta_prediction(rng: np.random.Generator) -> dict[str, Any]:
    """Accuracy of a machine commanded in x, y, z, before any reading."""
    steps = range(-120, 121, 40)
    grid = [(x, y) for x in steps for y in steps if math.hypot(x, y) <= 140]
    points = []
    for x, y in grid:
        bowl = 30.0 + 0.002 * (x * x + y * y)
        after = {axis: bowl + float(rng.normal()) for axis in "xyz"}
        command = {
            "x_mm": float(x),
            "y_mm": float(y),
            "z_mm": 0.0,
        }
        before = {axis: 10 * error for axis, error in after.items()}
        points.append({"command": command, "before": before, "after": after})
    return {
        "reference": "absolute",
        "components": {axis: _component(True, "um", 0.5) for axis in "xyz"},
        "unit": dict.fromkeys("xyz", "um"),
        "poses": len(points),
        "map": points,
        "mode": "plan",
        "realised": None,
    }


def _map_point(
    z: float,
    psi: float,
    theta: float,
) -> dict[str, Any]:
    ripple = 0.2 * math.cos(math.radians(3.0 * psi))
    size = 0.5 + theta / 30.0 + ripple
    after = {name: 40.0 * scale * size for name, scale in SCALES.items()}
    after["psi"] = 300.0 / theta
    return {
        "command": {"z_mm": z, "psi_deg": psi, "theta_deg": theta},
        "before": {name: 7.0 * error for name, error in after.items()},
        "after": after,
    }


def _component(
    correctable: bool,
    unit: str,
    scale: float,
) -> dict[str, Any]:
    after = 66.0 if correctable else 310.0
    budget = {
        "home errors": 0.11,
        "joints": 0.42,
        "limb tilts": 0.2,
        "cups": 0.22,
        "noise": 0.05,
    }
    return {
        "compensatable": correctable,
        "before": spread(480.0 * scale, unit),
        "after": spread(after * scale, unit),
        "known": spread(66.0 * scale, unit),
        "budget": budget,
    }


def spread(rms: float, unit: str) -> dict[str, Any]:
    """A spread whose rms of one machine lies evenly between half and 1.5 times its rms."""
    return {
        "rms": rms,
        "p95": 1.9 * rms,
        "max": 2.7 * rms,
        "unit": unit,
        "rms_quantiles": [rms * (0.5 + p) for p in LEVELS],
    }


# -- held-out readings -----------------------------------------------------------------


def held_out(
    name: str,
    n: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Readings of another session, predicted by the fit."""
    half = 0.09 + 0.03 * rng.random(n)
    residuals = 0.5 * half * rng.normal(size=n)
    rms = float(np.sqrt(np.mean(residuals**2)))
    return {
        "name": name,
        "channel": "length",
        "n": n,
        "rms": rms,
        "rms_raw": 1.2 * rms,
        "unit": "mm",
        "coverage": float(np.mean(np.abs(residuals) <= half)),
        "residuals": residuals.tolist(),
        "half_widths": half.tolist(),
    }
