"""Each paper, step by step: the page's values against claims of studies and oracles."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import micro_cmm_geometry as cmm
from oracles import planar_geometry as planar
from oracles import prs_geometry as prs

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "papers.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
VERDICTS = ("confirmed", "procedure", "erratum", "not reproducible")
EQ17_AND_CUP = np.r_[a3.EQ17, 24, 25, 26]


def rows() -> dict[str, list[str]]:
    """The page's rows by their number."""
    cells = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in PAGE.splitlines()
        if re.match(r"\| [APMR]\d+ \|", line)
    ]
    return {row[0]: row[1:] for row in cells}


def rank(h: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(h, tol=1e-10 * np.linalg.norm(h, 2)))


# -- claims and tests that the page names ----------------------------------------------
def test_every_row_has_a_verdict_and_something_that_does_it():
    assert len(rows()) == 50
    for number, (_, does_it, *_, verdict) in rows().items():
        assert verdict.startswith(VERDICTS), number
        assert "`" in does_it or does_it.startswith("report"), number


def test_values_meet_the_claims_of_their_studies():
    checked = 0
    for number, row in rows().items():
        here = row[3]
        for study, name in re.findall(r"`(\w+)::(\w+)`", here):
            path = ROOT / "studies" / f"{study}.study.toml"
            claim = tomllib.loads(path.read_text(encoding="utf-8"))["expect"][name]
            stated = NUMBER.search(here)
            assert meets(claim, float(stated.group())), (number, claim)
            checked += 1
    assert checked > 15


def meets(claim: dict[str, Any], value: float) -> bool:
    """Whether a value is what a claim of a study demands."""
    low, high = claim.get("min", -np.inf), claim.get("max", np.inf)
    return bool(low <= value <= high) and claim.get("equals", value) == value


def test_every_test_that_the_page_names_exists():
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", PAGE)
    assert len(named) > 20
    for path, name in named:
        source = (ROOT / path).read_text(encoding="utf-8")
        assert f"def {name}(" in source or not name, (path, name)


# -- independent values ----------------------------------------------------------------
def bar_rows(strokes: list[float], points: int) -> np.ndarray:
    """Rows of the bar, Eq. (12), with the parameters of Eq. (17) and the cup."""
    return a3.approach_1(strokes, points)[6:, EQ17_AND_CUP]


def kappa(h: np.ndarray, directions: int) -> float:
    s = np.linalg.svd(h, compute_uv=False)
    return float(s[0] / s[directions - 1])


def as_lengths(h: np.ndarray) -> np.ndarray:
    """Eq. (14) with the rows of the home orientation times d."""
    return h * np.r_[np.ones(3), np.full(3, a3.D), np.ones(len(h) - 6)][:, None]


def smallest_theta() -> float:
    psi = np.linspace(0.0, 2.0 * np.pi, 721)
    z = np.full(721, a3.C + a3.D + 0.08)
    theta = a3.circle_theta(z, psi, np.array([0.0, 0.0, a3.Z_TEACH]))
    return float(np.degrees(theta.min()))


def strut_rank() -> int:
    """Eq. (14) at Table 2's poses: limbs have unknowns of their own."""
    alpha, beta = np.radians(prs.TABLE_2).T
    tip, rot, q = prs.nominal(np.zeros(len(alpha)), alpha, beta)
    h = prs.strut_rows(prs.struts(tip, rot, q, np.zeros((3, 6))), rot)
    return sum(rank(h[:, i]) for i in range(3))


def position_rank() -> int:
    """Probe positions over R_f, R_p, theta_f, theta_p and the zero of each leg."""
    nominal = np.r_[np.full(3, 0.2), np.full(3, 0.06), cmm.THETA, cmm.THETA]
    grid = np.meshgrid([-0.04, 0.0, 0.04], [-0.04, 0.0, 0.04], [-0.25, -0.15])
    points = np.column_stack([axis.ravel() for axis in grid])
    lengths = cmm.legs(points, cmm.centres(*nominal.reshape(4, 3)))

    def positions(p: np.ndarray) -> np.ndarray:
        return cmm.probe(lengths + p[12:], cmm.centres(*p[:12].reshape(4, 3))).ravel()

    at, step = np.r_[nominal, np.zeros(3)], 1e-5
    steps = step * np.eye(15)
    h = np.column_stack([positions(at + s) - positions(at - s) for s in steps])
    singular = np.linalg.svd(h / (2 * step), compute_uv=False)
    return int((singular > 1e-6 * singular[0]).sum())


def workspace_rank() -> int:
    rng = np.random.default_rng(0)
    pose = np.column_stack([rng.uniform(-1.5, 1.5, 101), rng.uniform(0.0, 1.5, 101)])
    j = planar.rows(pose)
    return rank((j[1:] - j[0]).reshape(-1, 7))


def amplification(h: np.ndarray, poses: int) -> float:
    """Eq. (17), angles times 1 m."""
    s = np.linalg.svd(h, compute_uv=False)
    s = s[s > 1e-9 * s[0]]
    return float(np.exp(np.log(s).mean()) / np.sqrt(poses))


def of_rm(number: int) -> float:
    h = planar.identification_rows(number)
    return amplification(h, len(planar.lines(number)[0]))


def step_two() -> float:
    pose = np.array([(0.0, 0.2), (-1.5, 0.2), (1.5, 0.2)])
    j = planar.rows(pose)
    return amplification((j[1:] - j[0]).reshape(-1, 7)[:, [0, 1, 3, 4]], 3)


INDEPENDENT: dict[str, Callable[[], float]] = {
    "A2": lambda: bar_rows([0.08, 0.2], 15).shape[1],
    "A3": lambda: rank(a3.approach_1([0.08, 0.2], 15)),
    "A4": lambda: rank(a3.approach_1([0.08, 0.2], 11)),
    "A5": lambda: rank(bar_rows([0.08, 0.2], 15)),
    "A6": lambda: rank(bar_rows([0.08], 18)),
    "A9": smallest_theta,
    "A10": lambda: kappa(as_lengths(a3.approach_1([0.08, 0.2], 15)), 27),
    "A11": lambda: kappa(bar_rows([0.08, 0.2], 15), 18),
    "P2": strut_rank,
    "P6": lambda: float(np.abs(prs.TABLE_3 - prs.TABLE_1 - prs.TABLE_4).max()),
    "M3": position_rank,
    "R1": lambda: planar.rows(np.zeros(2)).shape[-1],
    "R2": workspace_rank,
    "R3": lambda: rank(planar.identification_rows(1)),
    "R4": lambda: rank(planar.identification_rows(2)),
    "R5": lambda: rank(planar.identification_rows(3)),
    "R6": lambda: rank(planar.identification_rows(4)),
    "R7": lambda: rank(planar.identification_rows(5)),
    "R8": lambda: of_rm(4),
    "R9": lambda: of_rm(3),
    "R12": step_two,
}


@pytest.mark.parametrize("number", INDEPENDENT)
def test_independent_values_are_those_of_the_page(number):
    """To the digits printed."""
    stated = rows()[number][4]
    digits = len(stated.partition(".")[2])
    tolerance = 0.51 * 10.0**-digits
    assert INDEPENDENT[number]() == pytest.approx(float(stated), abs=tolerance)


def test_each_independent_number_of_the_page_is_computed():
    numbers = {n for n, row in rows().items() if NUMBER.fullmatch(row[4])}
    assert numbers == set(INDEPENDENT)
