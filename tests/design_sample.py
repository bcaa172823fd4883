"""Small [design] studies, and criteria in plain NumPy to judge their plans by."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import sample

from oed.identifiability.assessment import assess
from oed.result import DesignSection
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.design.section import design_section
from pkm_studies.stages.design.select import ChosenDesign, select_design

HEAD = """\
schema = 1
name = "small"
machine = { model = "a3_head" }
report = { html = false, pdf = false }
"""
CUP = """
[[setup]]
name = "cup"
instrument = "ball_bar"
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }
"""
FREE = """
[[setup]]
name = "{name}"
instrument = "ball_bar_free_cup"
at_x_mm = {x}
at_y_mm = 0.0
at_z_mm = {z}
"""
GRID = """
[[design.candidates]]
setup = "{name}"
z_mm = [1086, 1246]
psi_deg = [0, 100, 130, 230]
theta = "hold"
"""
WORKSPACE = """
[prediction]
z_mm = [1066, 1266]
psi_deg = [0, 130]
theta_deg = [10, 30]
"""
KNOWN = 'scaling = "tolerance"\nprior = true\nreadings = 3\n'


def text(
    design: str,
    *,
    tables: str = GRID.format(name="cup"),
    setups: str = CUP,
    workspace: str = WORKSPACE,
) -> str:
    return HEAD + setups + "[design]\n" + design + tables + workspace


def chosen(text: str, folder: Path = Path()) -> tuple[ResolvedStudy, ChosenDesign]:
    resolved = sample.resolved(text, folder)
    design = select_design(resolved, np.random.default_rng(0))
    assert design is not None
    return resolved, design


def section(resolved: ResolvedStudy, design: ChosenDesign) -> DesignSection:
    assert resolved.study.design is not None
    return design_section(
        resolved,
        design,
        assess(design.measurement, design.series, resolved.study.design.scaling),
    )


def rows(resolved: ResolvedStudy) -> np.ndarray:
    m = resolved.measurement
    return (m.jacobian(resolved.candidates, m.nominal) * m.tolerance / 0.5e-6)[
        :, m.free
    ]


def slopes(resolved: ResolvedStudy) -> np.ndarray:
    """Home-referenced x and z of the tool point over the free parameters (poses, 2, n),
    by differences of poses.
    """
    m, kinematics = resolved.measurement, resolved.measurement.kinematics
    assert resolved.prediction is not None
    command = np.vstack([m.machine.home_command, resolved.prediction.command])
    x, q = kinematics.inverse(command)
    p, step = m.machine.nominal, 1e-6
    differences = []
    for k in range(len(p)):
        e = step * np.eye(len(p))[k]
        ends = [
            kinematics.forward(q, (p + s * e)[None], x)[0][:, [0, 2]] for s in (1, -1)
        ]
        differences.append((ends[0] - ends[1]) / (2 * step))
    table = np.moveaxis(np.array(differences), 0, 2)
    wide = np.zeros((len(command) - 1, 2, len(m.names)))
    wide[:, :, : len(p)] = (table[1:] - table[0]) * m.tolerance[: len(p)]
    return wide[:, :, m.free] / np.array([30e-6, 20e-6])[:, None]


def value(name: str, h: np.ndarray, resolved: ResolvedStudy) -> float:
    """A criterion of chosen rows with the tolerances, the larger the better."""
    m = h.T @ h + np.eye(h.shape[1])
    w, inverse = np.linalg.eigvalsh(m), np.linalg.inv(m)
    names = [
        n
        for n, f in zip(
            resolved.measurement.names, resolved.measurement.free, strict=True
        )
        if f
    ]
    if name == "Ds":
        columns = [k for k, n in enumerate(names) if n.startswith("dq")]
        return -float(np.linalg.slogdet(inverse[np.ix_(columns, columns)])[1])
    if name == "c":
        c = np.zeros(len(names))
        c[names.index("dq1")], c[names.index("beta2")] = (
            1e-3,
            -20e-3,
        )  # tolerances times coefficients
        return -float(c @ inverse @ c)
    if name in ("I", "G"):
        variance = np.einsum(
            "jkn,nm,jkm->j", slopes(resolved), inverse, slopes(resolved)
        )
        return -float(variance.mean() if name == "I" else variance.max())
    values = {
        "D": np.log(w).sum(),
        "O1": np.exp(np.log(w).mean() / 2) / np.sqrt(len(h)),
        "A": -np.sum(1 / w),
        "E": w[0],
        "kappa": -np.sqrt(w[-1] / w[0]),
        "O2": np.sqrt(w[0] / w[-1]),
        "O3": np.sqrt(w[0]),
        "O4": w[0] / np.sqrt(w[-1]),
        "O5": 1 / np.sum(w**-0.5),
    }
    return float(values[name])


EXTRA = (
    'interest = ["dq*"]\ncombination = { dq1 = 1.0, beta2 = -2.0 }\naccuracy = { x_um ='
    " 30, z_um = 20 }\n"
)
THREE = "".join(
    FREE.format(name=n, x=x, z=z)
    for n, x, z in (("low", 0, 1126), ("high", 0, 1286), ("side", 80, 1286))
)
GRIDS = "".join(
    GRID.format(name=n).replace("[1086, 1246]", "[1126, 1226]")
    for n in ("low", "high", "side")
)
