"""A made-up but realistic result of a study, as decoded from result.json: the A3 head
under a ball bar.

24 parameters (18 of the machine, 3 for each of two cups), 30 poses in two set-ups, 3
lost directions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import report_fixture_design

from oed.arrays import Array

A = B = 0.250
C, D = 0.526, 0.540
PHI = [2.0 * math.pi * i / 3.0 - math.pi / 2.0 for i in range(3)]
SETUPS = {
    "short tool": (0.080, 0.300),
    "long tool": (0.200, 0.250),
}  # stroke and bar length, m
LENGTHS = (
    [f"dq{i}" for i in (1, 2, 3)]
    + ["db1y", "db2x", "db3x"]
    + [f"da{i}{k}" for i in (1, 2, 3) for k in "xyz"]
)
TILTS = [f"beta{i}" for i in (1, 2, 3)]
CUPS = [f"{name} cup_{k}" for name in ("short", "long") for k in "xyz"]
NAMES = LENGTHS + TILTS + CUPS
COMPONENTS = {
    "x": "um",
    "y": "um",
    "z": "um",
    "psi": "arcsec",
    "theta": "arcsec",
    "phi": "arcsec",
}
TEXT = """schema = 1
title = "A3 head with a double ball bar"  # <tags> & $pecial \\ characters

[machine]
name = "a3_head"

[[setup]]
name = "short tool"
instrument = "ball_bar"
length_mm = 300
sigma_um = 0.5

[design]
criterion = "D"
readings = 30

[expect]
rank = 21
"""


def sample() -> dict[str, Any]:
    """The whole result; every call builds the same one anew."""
    rng = np.random.default_rng(7)
    poses = _poses()
    return {
        "schema": 1,
        "version": "0.1.0",
        "study": "a3_ball_bar",
        "title": "A3 head with a double ball bar",
        "question": (
            "Which 30 readings of a ball bar, in which order, and how accurate is the"
            " head afterwards?"
        ),
        "seed": 20240607,
        "seconds": 41.7,
        "machine": _machine(),
        "setups": _setups(),
        "study_text": TEXT,
        "versions": {
            "python": "3.11.7",
            "numpy": "2.4.1",
            "casadi": "3.8.0",
            "pkm-oed": "0.1.0",
        },
        "headline": [
            "The plan sees 21 of 24 parameters; 3 directions are lost.",
            (
                "30 readings in 2 set-ups reach log det -58.68, 2 % below the bound of"
                " -58.20 in D-efficiency."
            ),
            "The condition number over the seen directions is 3748.",
            (
                "Relative to home, z is known to 66 µm and the spindle axis to 5.2"
                " arcsec (1 sigma, rms) afterwards."
            ),
            "The virtual machine realised 0.97 of the predicted error.",
        ],
        "identifiability": _identifiability(24, 21, rng),
        "identifiability_of": {
            "one circle": _identifiability(21, 17, rng),
            "one tool length": _identifiability(21, 18, rng),
            "two tool lengths, two set-ups": _identifiability(24, 23, rng),
        },
        "design": report_fixture_design.design(poses),
        "kappa_maps": _kappa_maps(rng),
        "plan": _plan(),
        "estimate": _estimate(rng),
        "posterior": _posterior(rng),
        "prediction": _prediction(rng),
        "held_out": [
            _held_out("second day", 40, rng),
            _held_out("short tool, repeated", 12, rng),
        ],
        "drawing": _drawing(poses),
        "warnings": [
            "3 directions keep their tolerance: the platform's rotations about the TCP."
        ],
        "claims": _claims(),
    }


def bare() -> dict[str, Any]:
    """A result whose optional sections are all null or empty."""
    full = sample()
    for key in (
        "identifiability",
        "design",
        "plan",
        "estimate",
        "posterior",
        "prediction",
        "drawing",
    ):
        full[key] = None
    for key in ("kappa_maps", "held_out", "warnings", "claims", "setups", "headline"):
        full[key] = []
    full["identifiability_of"] = {}
    return full


def delta() -> dict[str, Any]:
    """A machine commanded in x, y, z, known from probing heights; no truth, no
    posterior.
    """
    full = sample()
    rng = np.random.default_rng(8)
    full |= {
        "study": "delta",
        "title": "Linear delta with a height probe",
        "posterior": None,
        "kappa_maps": [],
    }
    full["prediction"] = _delta_prediction(rng)
    full["drawing"] = _delta_drawing()
    for value in full["estimate"]["parameters"].values():
        value["truth"] = None
    return full


def _rotation(psi: float, theta: float) -> Array:
    axis = np.array([math.cos(psi), math.sin(psi), 0.0])
    cross = np.array(
        [[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]]
    )
    turn: Array = (
        np.eye(3) + math.sin(theta) * cross + (1 - math.cos(theta)) * cross @ cross
    )
    return turn


def _poses() -> list[dict[str, Any]]:
    return [
        _pose(name, stroke, bar, k, 2.0 * math.pi * k / 15.0)
        for name, (stroke, bar) in SETUPS.items()
        for k in range(15)
    ]


def _pose(name: str, stroke: float, bar: float, k: int, psi: float) -> dict[str, Any]:
    theta = math.radians(30.0 + 4.0 * math.sin(3.0 * psi + stroke))
    command = {
        "z_mm": 1e3 * (C + D + stroke),
        "psi_deg": math.degrees(psi),
        "theta_deg": math.degrees(theta),
    }
    reading = {"length_mm": 1e3 * bar}
    return {
        "setup": name,
        "run": f"circle {name[0]}",
        "order": k,
        "command": command,
        "reading": reading,
    }


def _joints(radius: float) -> Array:
    return np.array([[radius * math.cos(a), radius * math.sin(a), 0.0] for a in PHI])


def _tip(pose: dict[str, Any]) -> Array:
    """Tool point on the bar's sphere, roughly."""
    psi, theta = (math.radians(pose["command"][n]) for n in ("psi_deg", "theta_deg"))
    height = pose["command"]["z_mm"] * 1e-3
    tip = _rotation(psi, theta) @ np.array([0.0, 0.0, C])
    return np.array([tip[0], tip[1], height])


def _drawing(poses: list[dict[str, Any]]) -> dict[str, Any]:
    base, platform = _joints(B), _joints(A) + np.array([0.0, 0.0, D])
    lines = [
        _line("machine", [*base, base[0]]),
        _line("machine", [*platform, platform[0]]),
    ]
    lines += [_line("machine", [b, a]) for b, a in zip(base, platform, strict=True)]
    lines.append(_line("machine", [platform.mean(axis=0), np.array([0.0, 0.0, C + D])]))
    tips = [_tip(pose) for pose in poses]
    cup = {
        name: np.array([0.0, 0.0, C + D + stroke - 0.14])
        for name, (stroke, _) in SETUPS.items()
    }
    lines += [_line("cup", [point]) for point in cup.values()]
    return {
        "lines": lines,
        "tool_points": [tip.tolist() for tip in tips],
        "reading_of": [pose["setup"] for pose in poses],
        "bars": [
            [cup[pose["setup"]].tolist(), tip.tolist()]
            for pose, tip in zip(poses, tips, strict=True)
        ],
    }


def _line(kind: str, points: list[Array]) -> dict[str, Any]:
    return {"kind": kind, "points": [p.tolist() for p in points]}


def _delta_drawing() -> dict[str, Any]:
    radius, height = 0.16, 0.72
    feet = [np.array([radius * math.cos(a), radius * math.sin(a), 0.0]) for a in PHI]
    tool = np.array([0.0, 0.0, 0.02])
    lines = [
        _line("machine", [foot, foot + np.array([0.0, 0.0, height])]) for foot in feet
    ]
    lines += [
        _line("machine", [foot + np.array([0.0, 0.0, 0.33]), tool]) for foot in feet
    ]
    points = [[0.05 * i, 0.05 * j, 0.0] for i in range(-2, 3) for j in range(-2, 3)]
    return {
        "lines": lines,
        "tool_points": points,
        "reading_of": ["probe"] * len(points),
        "bars": [],
    }


def _machine() -> dict[str, Any]:
    rows = [
        {
            "name": n,
            "nominal": 0.0,
            "tolerance": 1.0,
            "unit": "mm",
            "about": f"joint error {n[1:]}",
        }
        for n in LENGTHS
    ]
    rows += [
        {
            "name": n,
            "nominal": 0.0,
            "tolerance": 10.0,
            "unit": "mrad",
            "about": "tilt of the limb",
        }
        for n in TILTS
    ]
    return {
        "name": "a3_head",
        "about": "A3 spindle head (3-RPS): z, psi, theta driven; x, y, phi parasitic",
        "source": "Tian et al. 2016, Mech. Mach. Theory 102, 167-178",
        "parameters": rows,
        "frame": ["db1x", "db2y", "db3y", "db1z", "db2z", "db3z"],
    }


def _setups() -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "instrument": "ball_bar",
            "about": "double ball bar, table cup taught by the machine",
            "numbers": {"length_mm": 1e3 * bar, "tool_z_mm": 1e3 * (stroke - 0.08)},
            "sigma": {"length_um": 0.5},
            "unknowns": {f"cup_{k}_mm": 0.02 for k in "xyz"},
        }
        for name, (stroke, bar) in SETUPS.items()
    ]


def _identifiability(n: int, rank: int, rng: np.random.Generator) -> dict[str, Any]:
    seen = np.sort(np.exp(rng.uniform(math.log(1.2e-3), math.log(4.7), rank)))[::-1]
    zero = 1e-16 * (1.0 + rng.random(n - rank))
    return {
        "parameters": NAMES[:n],
        "n": n,
        "rank": rank,
        "tolerance": 1e-9,
        "scaling": "lengths in mm, angles times 540 mm",
        "singular_values": [*seen.tolist(), *zero.tolist()],
        "combinations": [
            {"da1x": 0.577, "da2x": 0.577, "da3x": 0.577},
            {"db2x": 0.71, "db3x": -0.71},
        ],
        "lost": (
            [{"da1y": 0.41, "da2x": -0.35, "da2y": -0.2, "da3x": 0.35, "da3y": -0.2}]
            * (n - rank)
        ),
        "words": _words(n - rank),
    }


def _words(lost: int) -> list[dict[str, Any]]:
    seen = "Each of dq1, dq2, dq3, beta1, beta2, beta3 on its own."
    sums = (
        "Only the sum da1x + da2x + da3x (the platform triangle's shift in x), not its"
        " parts."
    )
    spin = (
        "Rotations of the platform joints about the TCP: a bar sees a point, not an"
        " orientation."
    )
    words = [
        {"kind": "seen", "text": seen, "remedies": []},
        {
            "kind": "combination",
            "text": sums,
            "remedies": ["a second tool length of 100 mm more or less"],
        },
        {
            "kind": "weak",
            "text": "db1y: its standard deviation stays at 0.8 of its tolerance.",
            "remedies": [],
        },
    ]
    remedies = [
        "a second tool length (two of the three)",
        "an instrument that reads orientation (all three)",
    ]
    return words + (
        [{"kind": "lost", "text": spin, "remedies": remedies}] if lost else []
    )


def _kappa_maps(rng: np.random.Generator) -> list[dict[str, Any]]:
    points = list(range(9, 25))
    taught = [
        3908,
        5210,
        4587,
        3748,
        4530,
        4300,
        4184,
        4300,
        4439,
        4400,
        4420,
        4410,
        4420,
    ]
    second = [float("nan"), 61000.0, 9000.0, *map(float, taught)]
    maps = []
    for title, size in (
        ("cup taught by the machine", 1.0),
        ("cup as free unknown", 4.7),
    ):
        rows = [[size * k * f for k in second] for f in (1.0, 0.62, 0.48)]
        rows = [
            [None if math.isnan(k) else k * (1.0 + 0.02 * rng.random()) for k in row]
            for row in rows
        ]
        maps.append(
            {"title": title, "circles": [2, 3, 4], "points": points, "kappa": rows}
        )
    return maps


def _plan() -> dict[str, Any]:
    def stage(name: str, setups: list[str], seen: int, kappa: float) -> dict[str, Any]:
        predicted = {"z_um": 66.0, "theta_arcsec": 5.2}
        head = {
            "measurement": name,
            "setups": setups,
            "readings": 15 * len(setups),
            "identifies": seen,
        }
        return head | {
            "cost": 16.5 * len(setups),
            "kappa": kappa,
            "predicted": predicted,
        }

    stages = [
        stage("one circle", ["short tool"], 17, 8120.0),
        stage("second circle", ["long tool"], 4, 3748.0),
    ]
    return {
        "stages": stages,
        "cost": 33.0,
        "alternatives": ["A length gauge along z halves the error of z."],
    }


def _estimate(rng: np.random.Generator) -> dict[str, Any]:
    before = np.concatenate(
        [60.0 * np.sin(np.linspace(0, 12, 30)) + 25.0 * rng.normal(size=30)]
    )
    after = 0.5 * rng.normal(size=30)
    return {
        "parameters": {name: _value(name, rng) for name in NAMES},
        "rms_before": {"length": float(np.sqrt(np.mean(before**2)))},
        "rms_after": {"length": float(np.sqrt(np.mean(after**2)))},
        "units": {"length": "um"},
        "channels": ["length"] * 30,
        "readings": 30,
        "dof": 9.0,
        "chi2": 10.2,
        "iterations": [
            {"step": float(k), "rms_um": 50.0 * 0.05**k + 0.41, "damping": 10.0**-k}
            for k in range(4)
        ],
        "warnings": ["9 degrees of freedom: chi2 says little about the noise."],
        "residuals": after.tolist(),
        "residuals_before": before.tolist(),
    }


def _value(name: str, rng: np.random.Generator) -> dict[str, Any]:
    prior = 10.0 if name in TILTS else 0.02 if name in CUPS else 1.0
    sd = prior * float(np.exp(rng.uniform(math.log(2e-3), 0.0)))
    kind = "seen" if sd < 0.3 * prior else "weak" if sd < 0.9 * prior else "prior"
    truth = float(prior * rng.normal())
    value = truth + sd * float(rng.normal())
    unit = "mrad" if name in TILTS else "mm"
    head = {"value": value, "sd": sd, "unit": unit, "nominal": 0.0}
    return head | {"prior_sd": prior, "identified": kind, "truth": truth}


def _posterior(rng: np.random.Generator) -> dict[str, Any]:
    marginals = {}
    for name in NAMES:
        mean, sd = float(rng.normal()), float(0.02 + 0.5 * rng.random())
        span = {
            "mean": mean,
            "sd": sd,
            "q025": mean - 1.96 * sd,
            "q975": mean + 1.96 * sd,
        }
        quality = {
            "rhat": float(1.0 + 0.008 * rng.random()),
            "ess": float(rng.integers(1050, 4000)),
        }
        marginals[name] = span | quality | {"unit": "mrad" if name in TILTS else "mm"}
    mix = np.array(
        [
            [1.0, 0, 0, 0, 0],
            [0.1, 0.95, 0, 0, 0],
            [0, 0.4, 0.6, 0, 0],
            [0, 0, 0.2, 0.3, 0],
            [0, 0, 0, 0.1, 0.1],
        ]
    )
    draws = rng.normal(size=(2000, 5)) @ mix.T + [0.0, 0.1, -0.6, 0.4, 1.2]
    return {
        "marginals": marginals,
        "acceptance": 0.27,
        "draws": 40000,
        "walkers": 96,
        "autocorrelation": 31.4,
        "directions": [
            "spin about the TCP",
            "tilt x about TCP",
            "tilt y about TCP",
            "db1y",
            "0.7 db2x - 0.7 db3x",
        ],
        "corner": np.round(draws, 4).tolist(),
    }


def _spread(rms: float, unit: str) -> dict[str, Any]:
    return {"rms": rms, "p95": 1.9 * rms, "max": 2.7 * rms, "unit": unit}


def _component(name: str, unit: str, scale: float) -> dict[str, Any]:
    corrected = name in ("z", "psi", "theta")
    before, after = 480.0 * scale, (66.0 if corrected else 310.0) * scale
    known = 66.0 * scale
    return {
        "compensatable": corrected,
        "before": _spread(before, unit),
        "after": _spread(after, unit),
        "known": _spread(known, unit),
        "budget": {
            "home errors": 0.11,
            "joints": 0.42,
            "limb tilts": 0.2,
            "cups": 0.22,
            "noise": 0.05,
        },
    }


def _prediction(rng: np.random.Generator) -> dict[str, Any]:
    scale = {"x": 0.85, "y": 0.8, "z": 1.0, "psi": 2.1, "theta": 0.08, "phi": 0.5}
    parts = {
        name: _component(name, unit, scale[name]) for name, unit in COMPONENTS.items()
    }
    commands = [
        {"z_mm": z, "psi_deg": psi, "theta_deg": theta}
        for z in (1066.0, 1166.0, 1266.0)
        for theta in (5.0, 15.0, 25.0, 35.0)
        for psi in range(0, 360, 30)
    ]
    points = []
    for command in commands:
        shape = (
            0.5
            + command["theta_deg"] / 30.0
            + 0.2 * math.cos(math.radians(3.0 * command["psi_deg"]))
        )
        after = {name: 40.0 * scale[name] * shape for name in COMPONENTS}
        after["psi"] = 300.0 / command["theta_deg"]
        points.append(
            {
                "command": command,
                "before": {n: 7.0 * v for n, v in after.items()},
                "after": after,
            }
        )
    realised = {
        n: _spread(p["after"]["rms"] * float(rng.uniform(0.85, 1.15)), COMPONENTS[n])
        for n, p in parts.items()
    }
    head = {
        "reference": "home",
        "components": parts,
        "unit": COMPONENTS,
        "poses": len(points),
        "map": points,
    }
    return head | {"mode": "identified", "realised": realised}


def _delta_prediction(rng: np.random.Generator) -> dict[str, Any]:
    grid = [
        (x, y)
        for x in range(-120, 121, 40)
        for y in range(-120, 121, 40)
        if math.hypot(x, y) <= 140
    ]
    points = []
    for x, y in grid:
        after = {k: 30.0 + 0.002 * (x * x + y * y) + float(rng.normal()) for k in "xyz"}
        command = {"x_mm": float(x), "y_mm": float(y), "z_mm": 0.0}
        points.append(
            {
                "command": command,
                "before": {k: 10 * v for k, v in after.items()},
                "after": after,
            }
        )
    parts = {k: _component("z", "um", 0.5) for k in "xyz"}
    head = {
        "reference": "absolute",
        "components": parts,
        "unit": dict.fromkeys("xyz", "um"),
    }
    return head | {
        "poses": len(points),
        "map": points,
        "mode": "plan",
        "realised": None,
    }


def _held_out(name: str, n: int, rng: np.random.Generator) -> dict[str, Any]:
    half = 0.09 + 0.03 * rng.random(n)
    residuals = 0.5 * half * rng.normal(size=n)
    inside = float(np.mean(np.abs(residuals) <= half))
    rms = float(np.sqrt(np.mean(residuals**2)))
    head = {
        "name": name,
        "channel": "length",
        "n": n,
        "rms": rms,
        "rms_raw": 1.2 * rms,
        "unit": "mm",
        "coverage": inside,
    }
    return head | {"residuals": residuals.tolist(), "half_widths": half.tolist()}


def _claims() -> list[dict[str, Any]]:
    return [
        {"claim": "rank of the plan", "measured": 21.0, "wanted": "= 21", "met": True},
        {
            "claim": "log det of the chosen plan",
            "measured": -58.68,
            "wanted": ">= -58.70",
            "met": True,
        },
        {
            "claim": "realised over predicted",
            "measured": 0.97,
            "wanted": "0.8 .. 1.25",
            "met": True,
        },
        {
            "claim": "spindle axis, rms [arcsec]",
            "measured": 5.2,
            "wanted": "<= 4",
            "met": False,
        },
    ]
