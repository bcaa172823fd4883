"""A made-up but realistic design of 30 readings, with every optional part."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def design(poses: list[dict[str, Any]]) -> dict[str, Any]:
    """Every field of a design, for poses in two set-ups."""
    setups = list(dict.fromkeys(pose["setup"] for pose in poses))
    plans = [
        _score("chosen", 30, -58.68, 1.0, 5210.0, 1.0),
        _score("two circles of 15 (paper)", 30, -65.58, 0.68, 3748.0, 1.45),
        _score("random, best of 200", 30, -63.2, 0.78, 9120.0, 1.21),
    ]
    certificate = (
        "Certified to 97.3 % of the best possible 26 of 1512 readings, over the 18 of"
        " 21 directions that the candidates see (the identifiable subspace), beside 4"
        " readings kept."
    )
    return {
        "criterion": "D",
        "n": 30,
        "value": -58.68,
        "bound": -58.20,
        "efficiency": 0.9737,
        "kappa": 5210.0,
        "observability": plans[0]["observability"],
        "poses": poses,
        "scaling": "lengths in mm, angles times 540 mm",
        "candidates": 1512,
        "plans": plans,
        "words": certificate,
        "directions": 18,
        "columns": 21,
        "gap": 0.0021,
        "proven": False,
        "compound": {"D": 2.0, "I": 1.0},
        "setups": setups,
        "kept": 4,
        "cost_min": 33.0,
        "refused": {
            "leave the travel of joint q2": 37,
            "cannot hold their reading": 284,
        },
        "compared": _criteria(),
        "polished": {
            "before": -58.91,
            "after": -58.68,
            "words": "polishing gained 0.01278 (solved to an optimum)",
            "setups": {
                "long tool": {"at_x_mm": 103.27, "at_z_mm": 1281.5},
                "short tool": {"tool_z_mm": 96.4},
            },
        },
        "order": {
            "setups": setups,
            "before_s": 126.2,
            "after_s": 95.6,
            "exact": True,
            "references": 3,
            "minutes": 36.4,
        },
        "robust": _robust(),
        "how_many": _how_many(),
    }


def _criteria() -> list[dict[str, Any]]:
    """Three criteria over 18 directions, each plan best by its own."""
    values = {
        "D": {"D": -58.85, "E": -60.99, "kappa": -60.48},
        "E": {"D": 2.172e-6, "E": 3.028e-6, "kappa": 2.997e-6},
        "kappa": {"D": 3142.3, "E": 2695.9, "kappa": 2691.4},
    }
    bounds = {"D": (-58.38, 0.9742), "E": (3.22e-6, 0.9404), "kappa": (None, None)}
    gains = {"D": 1.0, "E": 3.028 / 2.172, "kappa": 3142.3 / 2691.4}
    return [
        {
            "name": name,
            "value": cross[name],
            "bound": bounds[name][0],
            "efficiency": bounds[name][1],
            "proven": False,
            "gain": gains[name],
            "values": cross,
        }
        for name, cross in values.items()
    ]


def _robust() -> dict[str, Any]:
    rng = np.random.default_rng(9)
    nominal = -3.2 - 0.18 * np.abs(rng.normal(size=20))
    values = nominal + 0.03 + 0.5 * np.clip(-3.3 - nominal, 0.0, None)
    worst = [float(np.mean(np.sort(v)[:4])) for v in (values, nominal)]
    return {
        "risk": "cvar",
        "level": 0.2,
        "scenarios": 20,
        "value": worst[0],
        "bound": worst[0] + 0.03,
        "efficiency": math.exp(-0.03),
        "nominal": worst[1],
        "values": values.tolist(),
        "nominal_values": nominal.tolist(),
    }


def _how_many() -> dict[str, Any]:
    sizes = [10, 15, 20, 30, 40, 60]
    scale = {
        "x_um": 52.0,
        "y_um": 51.0,
        "z_um": 88.0,
        "psi_arcsec": 18.1,
        "theta_arcsec": 1.9,
        "phi_arcsec": 17.7,
    }
    return {
        "wanted": {"z_um": 50.0, "theta_arcsec": 1.2},
        "sizes": sizes,
        "accuracy": {name: _curve(at_11, sizes) for name, at_11 in scale.items()},
        "bound": {name: _curve(0.93 * at_11, sizes) for name, at_11 in scale.items()},
        "fewest": 34,
        "at_least": 33,
        "most": 60,
        "words": "34 readings reach it; no plan of fewer than 33 can.",
    }


def _curve(at_11: float, sizes: list[int]) -> list[float]:
    """Rms over the number of readings, from that of 11 readings."""
    return [at_11 * (n / 11.0) ** -0.5 for n in sizes]


def _score(
    name: str, n: int, logdet: float, efficiency: float, kappa: float, worse: float
) -> dict[str, Any]:
    observability = {
        "O1": 0.0173,
        "O2": 1.0 / kappa,
        "O3": 0.00124,
        "O4": 3.2e-7,
        "O5": 0.0044,
    }
    scale = {
        "x_um": 18.3,
        "y_um": 17.4,
        "z_um": 27.6,
        "psi_arcsec": 6.01,
        "theta_arcsec": 0.592,
        "phi_arcsec": 5.92,
    }
    return {
        "name": name,
        "n": n,
        "criterion": "D",
        "value": logdet,
        "logdet": logdet,
        "efficiency": efficiency,
        "kappa": kappa,
        "observability": observability,
        "predicted": {key: worse * rms for key, rms in scale.items()},
        "gain": dict.fromkeys(scale, 1.45 / worse),
    }
